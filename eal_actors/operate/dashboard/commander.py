"""Commander: carries out what browsers ask for, and tells each what came of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final, TypeAlias

from eal_actors.actors.combine import gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import (
    ArgumentError,
    ConfigError,
    EALError,
    PreemptedError,
    RobotNotFoundError,
    error_text,
)
from eal_actors.kernel.log import get_logger
from eal_actors.operate.dashboard.cameras import Cameras
from eal_actors.operate.dashboard.control import Control
from eal_actors.operate.dashboard.doings import Doings
from eal_actors.operate.dashboard.hub import plain
from eal_actors.operate.dashboard.messages import (
    CallResource,
    ControlRun,
    Describe,
    Drive,
    LetGo,
    ListScenarios,
    Resume,
    StartRun,
    Stop,
    Watch,
)
from eal_actors.operate.dashboard.runs import Runs
from eal_actors.operate.dashboard.steering import Steering, Twist
from eal_actors.operate.dashboard.watcher import infos_of

Reply: TypeAlias = Callable[[dict[str, Any]], None]
"""Takes an answer to a browser; called in any thread, and never blocks."""

STOP_REASON: Final = "STOP on the dashboard"
_WHOLE_ARRAY: Final = 64
_COMMANDING: Final = ("set_value", "send_cmd", "set_config")
"""The methods that take an actuator for whoever calls them."""


class Commander:
    """Does what messages mean. Who may say them is not asked here.

    Args:
        fleet: a connected fleet.
        doings: what the robots do.
        control: who commands what.
        runs: the scenarios.
        steering: steers by hand.
        cameras: the cameras.

    Thread: any. `carry_out` does not wait for robots; where a message has files read, it blocks as long: see
    `reads_files`.
    """

    def __init__(
        self, fleet: Fleet, doings: Doings, control: Control, runs: Runs, steering: Steering, cameras: Cameras
    ) -> None:
        self._fleet = fleet
        self._doings = doings
        self._control = control
        self._runs = runs
        self._steering = steering
        self._cameras = cameras

    def reads_files(self, message: object) -> bool:
        """Return whether a message is to be carried out by a thread that may block."""
        return isinstance(message, ListScenarios | StartRun)

    def carry_out(self, message: Any, browser: str, reply: Reply) -> None:
        """Do what a message means, and reply when it is done.

        Args:
            message: one of `messages`.
            browser: names the browser.
            reply: where answers go.
        """
        number = getattr(message, "id", None)
        try:
            answer = self._do(message, browser, reply)
        except EALError as error:
            reply(failure(number, error))
        else:
            if answer is not None:
                reply({"id": number, "ok": True, **answer})

    def _do(self, message: Any, browser: str, reply: Reply) -> dict[str, Any] | None:
        match message:
            case Watch():
                self._cameras.watch(browser, message.cameras, message.rate_hz)
            case Describe():
                return {"resources": self._described(message.robot)}
            case ListScenarios():
                return {"scenarios": self._runs.listed()}
            case CallResource():
                self._call(message, browser, reply)
            case Stop():
                self._stop(message.id, reply)
            case Resume():
                get_logger().warning("the emergency stop is ended from the dashboard")
                self._tell_each(message.id, {name: robot.resume() for name, robot in self._fleet.items()}, reply)
            case Drive():
                self._drive(message, browser, reply)
            case LetGo():
                self._steering.let_go(browser, message.robot)
            case StartRun():
                self._runs.start(message.file, message.parameters)
                return {}
            case ControlRun():
                self._runs.control(message.what)
                return {}
        return None

    def leave(self, browser: str) -> None:
        """Halt what a browser steers, and forget it: it is gone."""
        self._steering.leave(browser)
        self._cameras.leave(browser)

    def _described(self, robot: str) -> list[dict[str, Any]]:
        if robot not in self._fleet:
            raise RobotNotFoundError(f"there is no robot {robot!r}")
        return [plain(info.to_dict()) for _, info in infos_of(self._fleet[robot])]

    def _drive(self, message: Drive, browser: str, reply: Reply) -> None:
        """Steer; the page is told which grip has come to its end, for it may hold the next one by then."""

        def tell(robot: str, error: EALError) -> None:
            reply({"trouble": {"robot": robot, "grip": message.grip, "code": error.code, "error": error.message}})

        twist = Twist(message.speed_m_s, message.turn_rad_s)
        try:
            self._steering.drive(browser, message.robot, message.grip, twist, tell)
        except EALError as error:
            tell(message.robot, error)

    # Stop.

    def _stop(self, number: int, reply: Reply) -> None:
        answers = {name: robot.stop(STOP_REASON) for name, robot in self._fleet.items()}  # first of all
        self._runs.abort(STOP_REASON)
        get_logger().warning("emergency stop of every robot, from the dashboard")
        self._tell_each(number, answers, reply)

    def _tell_each(self, number: int, answers: dict[str, Future[None]], reply: Reply) -> None:
        """Reply when every robot has answered, or is known not to."""

        def tell(done: Future[list[Any]]) -> None:
            outcomes = dict(zip(answers, done.get(), strict=True))
            failed = {
                name: error_text(outcome) for name, outcome in outcomes.items() if isinstance(outcome, BaseException)
            }
            for name, reason in failed.items():
                get_logger(robot=name).error("did not confirm", reason=reason)
            confirmed = [name for name in outcomes if name not in failed]
            reply({"id": number, "ok": not failed, "confirmed": confirmed, "failed": failed})

        gather(answers.values(), return_exceptions=True).add_done_callback(tell)

    # Calls.

    def _call(self, message: CallResource, browser: str, reply: Reply) -> None:
        if message.robot not in self._fleet:
            raise RobotNotFoundError(f"there is no robot {message.robot!r}")
        resource = self._fleet[message.robot][message.resource]
        label = " ".join(part for part in (message.resource, message.text or message.method) if part)
        if message.method in _COMMANDING:
            self._control.take(message.robot, message.resource, browser)

        def end(error: BaseException | None) -> None:
            if message.method in _COMMANDING:
                self._control.done(message.robot, message.resource)
            if error is not None and not isinstance(error, PreemptedError):
                self._doings.fail(message.robot, f"{label}: {error_text(error)}")

        def tell(done: Future[Any]) -> None:
            error = done.exception()
            end(error)
            if error is not None:
                reply(failure(message.id, error))
            else:
                reply({"id": message.id, "ok": True, "value": shown_value(done.get())})

        try:
            answer = _begun(resource, message)
        except EALError as error:
            end(error)
            raise
        answer.add_done_callback(tell)


def _begun(resource: ResourceHandle, message: CallResource) -> Future[Any]:
    text, value = message.text or "", list(message.value) if isinstance(message.value, tuple) else message.value
    match message.method:
        case "get_status":
            return resource.get_status()
        case "get_value":
            return resource.get_value()
        case "set_value":
            return resource.set_value(value)
        case "send_req":
            return resource.send_req(text)
        case "send_cmd":
            return resource.send_cmd(text, value)
        case "get_config":
            return resource.get_config(text)
        case "set_config":
            return resource.set_config(text, value)
        case "halt":
            return resource.halt()
    raise ArgumentError(f"there is no method {message.method!r}")


def failure(number: int | None, error: BaseException) -> dict[str, Any]:
    """Return the answer that tells of an error."""
    problems = [str(problem) for problem in error.problems] if isinstance(error, ConfigError) else []
    code = error.code if isinstance(error, EALError) else EALError.code
    return {"id": number, "ok": False, "code": code, "error": str(error), "problems": problems}


def shown_value(answer: EALData | int | None) -> str:
    """Return a value as people read it: numbers and text bare, large arrays in few words."""
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
