"""Dispatcher: executes the messages of browsers, and answers them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.kernel.errors import (
    ConfigError,
    EALError,
    PreemptedError,
    StaleCommandError,
    StoppedError,
    code_of,
    error_text,
    message_of,
)
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard import messages
from eal_actors.operate.dashboard.cameras import Cameras
from eal_actors.operate.dashboard.control import DashboardContext
from eal_actors.operate.dashboard.journeys import Journeys
from eal_actors.operate.dashboard.run_manager import RunManager
from eal_actors.operate.dashboard.state_store import to_json_value
from eal_actors.operate.dashboard.teleop import DRIVE_RESOURCE, Teleop, Twist
from eal_actors.operate.dashboard.values import ValuePoller, infos_of

Reply: TypeAlias = Callable[[dict[str, Any]], None]
"""Sends an answer to a browser; called in any thread, and never blocks."""

STOP_REASON: Final = "STOP on the dashboard"
_BLOCKING: Final = (
    messages.DecidePlan,
    messages.ListPlans,
    messages.ListScenarios,
    messages.ReloadFleet,
    messages.SendRobot,
    messages.StartRun,
)
HEARD_S: Final = 3.0
"""Real seconds: a command of a page whose newest update was older when it arrives is not executed. The page, which
receives one each second, shows after the same time that it is outdated."""
_WHOLE_ARRAY: Final = 64
_COMMANDS: Final = ("set_value", "send_cmd", "set_config")  # the methods that reserve a resource for their caller


class Dispatcher:
    """Executes messages. Permissions are checked by the caller.

    Thread: any. `execute` does not wait for robots. Messages for which `may_block` is true block on files or a robot.
    """

    def __init__(
        self, context: DashboardContext, runs: RunManager, teleop: Teleop, cameras: Cameras, values: ValuePoller
    ) -> None:
        self._fleet, _, self._steps, self._control = context
        self._journeys = Journeys(context)
        self._runs = runs
        self._teleop = teleop
        self._cameras = cameras
        self._values = values

    def may_block(self, message: object) -> bool:
        """Return whether a message must be executed in a thread that may block."""
        return isinstance(message, _BLOCKING)

    def execute(self, message: Any, browser: str, who: str, reply: Reply) -> None:
        """Execute one of `messages` from the browser of a user, and reply at its end."""
        number = getattr(message, "id", None)
        try:
            if not isinstance(message, messages.DriveRobot):  # whose errors name their press
                self._require_fresh(message)
            for robot in _bases_of(message):
                self._teleop.interrupt(robot)
            answer = self._execute(message, browser, who, reply)
        except EALError as error:
            reply(failure(number, error))
        else:
            if answer is not None:
                reply({"id": number, "ok": True, **answer})

    def _execute(self, message: Any, browser: str, who: str, reply: Reply) -> dict[str, Any] | None:
        """Return the answer; None if there is none, or if it comes later."""
        match message:
            case messages.Watch():
                self._cameras.watch(browser, message.cameras, message.rate_hz)
            case messages.WatchValues():
                self._values.watch(browser, message.robot)
            case messages.Describe():
                infos = infos_of(self._fleet[message.robot])
                return {"resources": [to_json_value(info.to_dict()) for _, info in infos]}
            case messages.CallResource():
                self._call(message, browser, reply)
            case messages.CommandRobots():
                self._command(message, browser, reply)
            case messages.SendRobot():
                self._send(message, browser, reply)
            case messages.StopAll():
                self._stop(message.id, reply)
            case messages.ResumeAll():
                get_logger().warning("emergency stop ended from the dashboard")
                self._reply_for_all(message.id, {name: robot.resume() for name, robot in self._fleet.items()}, reply)
            case messages.DriveRobot():
                self._drive(message, browser, reply)
            case messages.ReleaseRobot():
                self._teleop.release(browser, message.robot)
            case messages.ReloadFleet():
                return {"changes": str(self._fleet.reload())}
            case _:
                return self._execute_run(message, who)
        return None

    def _require_fresh(self, message: Any) -> None:
        """Raise StaleCommandError if a command was held up, by the network or because this computer slept."""
        if not messages.may_expire(message) or self._is_stop(message):
            return
        if message.heard_s is None:
            raise StaleCommandError("not executed: the page is of another release; reload it")
        age_s = (self._fleet.clock.now() - message.heard_s) / self._fleet.clock.of_real(1.0)
        if age_s > HEARD_S:
            raise StaleCommandError(f"not executed: the page showed a state of {age_s:.1f} s ago; send it again")

    def _is_stop(self, message: Any) -> bool:
        match message:
            case messages.CallResource(method="send_cmd", text=str(text)):
                names: tuple[str, ...] = (message.robot,)
            case messages.CommandRobots(text=text):
                names = message.robots
            case _:
                return False
        robots = [self._fleet[name] for name in names if name in self._fleet]
        handles = [robot[message.resource] for robot in robots if message.resource in robot]
        return bool(handles) and all(handle.is_stop(text) for handle in handles)

    def _execute_run(self, message: Any, who: str) -> dict[str, Any]:
        match message:
            case messages.ListScenarios():
                return {"scenarios": self._runs.list_scenarios()}
            case messages.StartRun():
                self._runs.start(message.file, message.parameters)
            case messages.ControlRun():
                self._runs.control(message.what)
            case messages.ListPlans():
                return {"plans": self._runs.list_plans()}
            case messages.DecidePlan():
                self._runs.decide(message.hash, f"{who}, dashboard", is_approved=message.approve)
        return {}

    def leave(self, browser: str) -> None:
        """Halt the robots that a closed browser drives, and forget it."""
        self._teleop.leave(browser)
        self._cameras.leave(browser)
        self._values.leave(browser)

    def _drive(self, message: messages.DriveRobot, browser: str, reply: Reply) -> None:
        """Drive by hand. Errors name their press, because the browser may have started the next one by then."""

        def on_error(robot: str, error: EALError) -> None:
            fields = {"robot": robot, "press": message.press, "code": error.code, "error": error.message}
            reply({"drive_error": fields})

        twist = Twist(message.speed_m_s, message.turn_rad_s)
        try:
            self._require_fresh(message)
            self._teleop.drive(browser, message.robot, message.press, twist, on_error)
        except EALError as error:
            on_error(message.robot, error)

    # Stop.

    def _stop(self, number: int, reply: Reply) -> None:
        self._runs.abort(STOP_REASON)  # which waits for nothing; first, or the run would fail with the stopped commands
        answers = {name: robot.stop(STOP_REASON) for name, robot in self._fleet.items()}
        get_logger().warning("emergency stop of every robot, from the dashboard")
        self._reply_for_all(number, answers, reply)

    def _reply_for_all(self, number: int, answers: dict[str, Future[None]], reply: Reply) -> None:
        """Reply when every robot has confirmed a stop or its end, or failed."""

        def on_done(done: Future[list[Any]]) -> None:
            answer = _answer_for_all(number, dict(zip(answers, done.get(), strict=True)))
            for name, reason in answer["failed"].items():
                # A warning, since an error of the robot would stay on the page.
                get_logger(robot=name).warning("did not confirm", reason=reason)
            reply(answer)

        gather(answers.values(), return_exceptions=True).add_done_callback(on_done)

    # Commands to several robots.

    def _command(self, message: messages.CommandRobots, browser: str, reply: Reply) -> None:
        """Send a command to each robot, and reply when all have ended; robots that do not know it fail at once."""
        outcomes: dict[str, Any] = {}
        for name in message.robots:
            try:
                outcomes[name] = self._start_command(name, message, browser)
            except EALError as error:
                outcomes[name] = error
                self._record(name, f"{message.resource} {message.text}", error)
        running = {name: outcome for name, outcome in outcomes.items() if isinstance(outcome, Future)}

        def on_done(done: Future[list[Any]]) -> None:
            reply(_answer_for_all(message.id, {**outcomes, **dict(zip(running, done.get(), strict=True))}))

        gather(running.values(), return_exceptions=True).add_done_callback(on_done)

    def _start_command(self, name: str, message: messages.CommandRobots, browser: str) -> Future[Any]:
        robot = self._fleet[name]
        if not message.resource:
            return robot.halt()
        value = list(message.value) if isinstance(message.value, tuple) else message.value
        resource = robot[message.resource]
        self._control.acquire(name, message.resource, browser)

        def on_done(done: Future[Any]) -> None:
            self._control.done(name, message.resource)
            self._record(name, f"{message.resource} {message.text}", done.exception())

        try:
            answer = resource.send_cmd(message.text, value)
        except EALError:
            self._control.done(name, message.resource)
            raise
        answer.add_done_callback(on_done)
        return answer

    # Calls.

    def _record(self, robot: str, label: str, error: BaseException | None) -> None:
        if error is not None and not isinstance(error, PreemptedError | StoppedError):
            self._steps.record_error(robot, f"{label}: {error_text(error)}")

    def _send(self, message: messages.SendRobot, browser: str, reply: Reply) -> None:
        def on_end(error: BaseException | None) -> None:
            self._record(message.robot, f"to ({message.x_m:.2f}, {message.y_m:.2f})", error)
            reply(failure(message.id, error) if error is not None else {"id": message.id, "ok": True})

        self._journeys.send(message, browser, on_end)

    def _call(self, message: messages.CallResource, browser: str, reply: Reply) -> None:
        resource = self._fleet[message.robot][message.resource]
        is_command = message.method in _COMMANDS
        if is_command:
            self._control.acquire(message.robot, message.resource, browser)

        def on_end(error: BaseException | None) -> None:
            if is_command:
                self._control.done(message.robot, message.resource)
            self._record(message.robot, f"{message.resource} {message.text or message.method}", error)

        def on_done(done: Future[Any]) -> None:
            error = done.exception()
            on_end(error)
            if error is not None:
                reply(failure(message.id, error))
            else:
                reply({"id": message.id, "ok": True, "value": format_value(done.get())})

        try:
            answer = _start_call(resource, message)
        except EALError as error:
            on_end(error)
            raise
        answer.add_done_callback(on_done)


def _bases_of(message: Any) -> tuple[str, ...]:
    """Return the robots whose bases a message moves or halts."""
    match message:
        case messages.CallResource(resource=resource, method="set_value" | "send_cmd" | "halt"):
            return (message.robot,) if resource == DRIVE_RESOURCE else ()
        case messages.CommandRobots(resource=resource):
            return message.robots if resource in ("", DRIVE_RESOURCE) else ()
        case messages.SendRobot():
            return (message.robot,)
        case _:
            return ()


def _answer_for_all(number: int, outcomes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the answer to a request to several robots, given each one's value or error."""
    failed = {name: message_of(outcome) for name, outcome in outcomes.items() if isinstance(outcome, BaseException)}
    confirmed = [name for name in outcomes if name not in failed]
    return {"id": number, "ok": not failed, "confirmed": confirmed, "failed": failed}


def _start_call(resource: ResourceHandle, message: messages.CallResource) -> Future[Any]:
    text, value = message.text or "", list(message.value) if isinstance(message.value, tuple) else message.value
    given = {
        "set_value": (value,),
        "send_req": (text,),
        "send_cmd": (text, value),
        "get_config": (text,),
        "set_config": (text, value),
    }
    answer: Future[Any] = getattr(resource, message.method)(*given.get(message.method, ()))
    return answer


def failure(number: int | None, error: BaseException) -> dict[str, Any]:
    """Return the answer to a failed request."""
    problems = [str(problem) for problem in error.problems] if isinstance(error, ConfigError) else []
    return {"id": number, "ok": False, "code": code_of(error), "error": str(error), "problems": problems}


def format_value(answer: EALData | int | None) -> str:
    """Return a value as text for people: numbers and texts in full, the shape of large arrays."""
    if not isinstance(answer, EALData):
        return "" if answer is None else str(answer)
    unit = f" {answer.unit}" if answer.unit else ""
    value = answer.value
    if answer.type is DataType.VOID:
        return "nothing" if value is None else f"{answer.length} bytes"
    if isinstance(value, bool):
        return "true" if value else "false"
    if not answer.is_ptr or isinstance(value, str):
        return f"{value}{unit}"
    shape = answer.shape or (len(value),)
    if math.prod(shape) <= _WHOLE_ARRAY:
        return f"{value.tolist() if hasattr(value, 'tolist') else list(value)}{unit}"
    return f"{' x '.join(map(str, shape))} {answer.type.value}{unit}"
