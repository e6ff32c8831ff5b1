"""The actor that owns one resource: runs its calls, steps its activities, and halts it when anything fails."""

from __future__ import annotations

import contextvars
import math
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from typing_extensions import override

from eal_actors.actors.activities import ScheduledCommand, status_of
from eal_actors.actors.call import MOTION_METHODS, Call, ResourceCell
from eal_actors.actors.readiness import ReadinessActor
from eal_actors.actors.robot_view import RunningCommand, command_of, process_name
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceInfo, ValueInfo
from eal_actors.device.plugin_context import ResourceFactory
from eal_actors.device.resource import Activity, Resource
from eal_actors.kernel import log
from eal_actors.kernel.errors import (
    DeadlineError,
    EALError,
    NotReadyError,
    ReturnTypeError,
    StaleCommandError,
    UnavailableError,
    error_text,
)
from eal_actors.kernel.unwinding import AbandonedThread

_ENDS: Final = "the resource is being stopped"
_FLOATS: Final = (DataType.FLOAT, DataType.DOUBLE)


class PendingResult(NamedTuple):
    """A result that an activity will return, and the function that makes the answer of it."""

    activity: Activity
    convert: Callable[[Any], Any]


def converted(result: Any, convert: Callable[[Any], Any]) -> Any:
    """Make the answer of a result; an activity gives its result later."""
    return PendingResult(result, convert) if type(result) is types.GeneratorType else convert(result)


def data_of(result: Any, value: ValueInfo | None = None) -> EALData:
    """Return the result as EALData, checked against the resource's information, or raise ReturnTypeError.

    An int is converted where a float or double is declared, so that 60 and 60.0 are the same answer.
    """
    if type(result) is EALData:
        data = result
    else:
        if type(result) is int and value is not None and value.type in _FLOATS and not value.shape:
            result = float(result)
        try:
            data = EALData.of(result)
        except EALError as error:
            raise ReturnTypeError(f"returned what no EALData can hold: {error}") from error
    if value is not None and (problem := value.problem(data)):
        raise ReturnTypeError(f"returned a value that {problem}")
    return data


@dataclass(frozen=True, slots=True)
class ResourceCallbacks:
    """The callbacks by which a resource's actor reports to its robot's. They run in its thread and must not block.

    Attributes:
        ready: its device can be used (None), or cannot for a reason.
        down: the resource has ended: crashed with an error, or normally with None.
        watch: check at that time whether the actor is stuck in its current step.
    """

    up: Callable[[ResourceActor, ResourceInfo], None]
    ready: Callable[[ResourceActor, str | None], None]
    down: Callable[[ResourceActor, BaseException | None], None]
    watch: Callable[[ResourceActor, float], None]


class ResourceActor(ReadinessActor):
    """Owns one resource: every access to it happens in this actor's thread."""

    def __init__(
        self, cell: ResourceCell, factory: ResourceFactory, callbacks: ResourceCallbacks, capacity: int
    ) -> None:
        super().__init__(cell, capacity)
        self.put = self.actor_inbox.put
        self.put_urgent = self.actor_inbox.put_urgent
        self.watched_until_s = math.inf
        """The time of the robot's next check whether the actor is stuck. The robot sets it to infinity first."""
        self._factory = factory
        self._callbacks = callbacks
        self.any_thread = False
        """Whether the resource allows calls in other threads; known once it is open."""
        self.glances = False
        """Whether the resource implements `glance`; known once it is open."""
        self.is_up = False
        """Whether it has started, and takes calls."""
        self._is_open = False
        self._current: Call[Any] | None = None
        self._scheduled = ScheduledCommand(self.actor_inbox, self._execute)

    # Life.

    @override
    def on_start(self) -> None:
        """Make and open the resource. Thread: the actor's own."""
        log.bind_resource(self.cell.robot, self.cell.name)
        self._context = contextvars.copy_context()
        self.busy(self.clock.now() + self.cell.timeout_s)
        try:
            self.resource = resource = self._factory.create()
            resource.name = self.cell.name
            resource.open()
            self._is_open = True
            self.any_thread = resource.any_thread
            self.actor_inbox.serve = self.serve_timers if self.any_thread else None
            self.glances = type(resource).glance is not Resource.glance
            info = resource.info()
            self._info = info
            self._methods = self._make_methods(resource, info)
            background = resource.background()
            if background is not None and type(background) is not types.GeneratorType:
                raise ReturnTypeError(f"background returned {background!r}, which is no generator")
            if type(resource).not_ready is not Resource.not_ready:  # most are always ready and need no check
                self._reports_readiness = True
                self._watch_readiness()
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything; Pykka would hide it
            self.crash(error)
            return
        self.busy_until_s = None
        if background is not None:
            self.begin_background(background)
        self.is_up = True
        self._callbacks.up(self, info)

    def _make_methods(self, resource: Resource, info: ResourceInfo) -> dict[str, Callable[..., Any]]:
        """Return for each method the function that runs it and converts its result."""
        value = info.value

        def get_value() -> Any:
            result = resource.get_value()
            if type(result) is EALData and (value is None or value.problem(result) is None):
                return result  # the usual case of the most frequent method
            return converted(result, lambda result: data_of(result, value))

        return {
            "get_status": lambda: status_of(resource.get_status()),
            "get_value": get_value,
            "set_value": self._set_value,
            "send_req": self._send_req,
            "send_cmd": self._send_cmd,
            "read_comm": lambda length: converted(resource.read_comm(length), data_of),
            "write_comm": lambda data, length: converted(resource.write_comm(data, length), status_of),
            "get_config": self._get_config,
            "set_config": lambda key, data: converted(resource.set_config(key, data), status_of),
            "halt": self._halt,
        }

    def halt_soon(self) -> None:
        """Halt before everything that waits; a resource that has nothing to halt is not woken. Thread: any."""
        resource = self.resource
        if resource is not None and type(resource).halt is not Resource.halt:
            self.run_soon(lambda: self.guarded(lambda: self._halt(_ENDS)))

    def shut_down(self) -> None:
        """Halt, close and stop, before everything that waits. Thread: any; does not block."""
        self.run_soon(self._shut_down)

    def _shut_down(self) -> None:
        self.actor_stopped.set()
        self._refuse(UnavailableError("the robot is being stopped"))
        self._stop()

    @override
    def on_crash(self, error: BaseException) -> None:
        """Halt and close the resource and report the crash. Thread: the actor's own."""
        try:
            self._release(f"the resource crashed: {error_text(error)}")
        finally:
            self._callbacks.down(self, error)

    @override
    def on_stop(self) -> None:
        """Halt and close the resource and report the end. Thread: the actor's own."""
        self._release(_ENDS)
        self._callbacks.down(self, None)

    @override
    def abandon(self, error: EALError) -> None:
        """Fail the running calls too; see EALActor."""
        running = [self._current, self._scheduled.call, *self.calls()]
        super().abandon(error)
        for call in running:
            if call is not None and self.clock.now() >= (call.deadline_s or math.inf):
                call.expire()  # its caller may not have woken up yet
            elif call is not None:
                call.fail(error.copy())

    @override
    def on_abandoned(self) -> None:
        """Halt and close the resource, now that the stuck code is unwound. Thread: the actor's own."""
        self._release("the resource was stuck and has been abandoned")

    @override
    def on_readiness(self, reason: str | None) -> None:
        self._callbacks.ready(self, reason)

    def _release(self, reason: str) -> None:
        self._scheduled.preempt(reason)
        self.close_activities(reason)
        resource, self.resource = self.resource, None
        if resource is not None:

            def destroy() -> None:
                self._factory.destroy(resource)

            for step in (resource.halt, resource.close, destroy) if self._is_open else (destroy,):
                self.guarded(step)

    @override
    def busy(self, until_s: float) -> None:
        """Note the deadline of the step that begins, and have the robot check it: once, not for every call."""
        self.busy_until_s = until_s
        if until_s < self.watched_until_s:
            self.watched_until_s = until_s
            self._callbacks.watch(self, until_s)

    # Calls.

    @override
    def _handle_receive(self, message: Any) -> Any:
        """Run a call. Thread: the actor's own."""
        return self._execute(message) if isinstance(message, Call) else super()._handle_receive(message)

    def _execute(self, call: Call[Any]) -> None:
        deadline_s = call.deadline_s or 0.0
        if call.stops:  # a late stop is still a stop
            deadline_s = max(deadline_s, self.clock.now() + self.cell.timeout_s)
        elif call._done or not self._may_begin(call, deadline_s):  # it was cancelled while it waited
            return
        self._current = call
        self.busy(deadline_s)
        log.set_call(call.call_id)
        if log.debug_enabled or call.span is not None:
            self._trace(call)
        try:
            if self._reports_readiness and not call.stops and (reason := self._check_readiness()) is not None:
                raise NotReadyError(reason)  # a function for this would cost every call
            result = self._methods[call.method](*call.arguments)
            if type(result) is PendingResult:
                self.begin(call, *result)
            elif not call.settle(result, None):
                self._undo(call)
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            self._fail_call(call, error)
        finally:
            self.busy_until_s = self._current = None
            log.set_call(None)

    def _may_begin(self, call: Call[Any], deadline_s: float) -> bool:
        """Return whether a call may begin now; one that may not fails, or waits for its start time."""
        now_s = self.clock.now()
        if deadline_s <= now_s:
            call.fail(DeadlineError(f"{call.method} waited in the mailbox until its deadline; it was not executed"))
            return False
        if call.begin_by_s is not None and now_s > call.begin_by_s:
            call.fail(StaleCommandError(f"{call.method} waited too long to be begun; it was not executed"))
            return False
        if self.cell.latch.reason is not None and self.cell.refuses(call):  # latched after the call was submitted
            return False
        if call.start_s is not None:
            if self._scheduled.is_early(call) and call.method in self._info.methods:
                self._schedule(call)
                return False
            call.began_s = self.clock.now()
        return True

    def _trace(self, call: Call[Any]) -> None:
        self._log.debug("call", method=call.text())
        if call.span is not None:
            handler = call.span.part(f"{self.cell.name}/{call.method} handler")
            call.link(lambda done, _: handler.end(done.exception()))

    def _fail_call(self, call: Call[Any], error: BaseException) -> None:
        if call.stops and isinstance(error, NotReadyError) and self._owe_halt(error):
            call.settle(1, None)
            return
        may_move = call.method in MOTION_METHODS and not isinstance(error, EALError)
        if may_move and isinstance(error, Exception):  # it may have started a motion; a crash halts by itself
            self.guarded(self.opened.halt)
        call.fail(self.explain(call, error))
        if not isinstance(error, Exception):
            raise error

    def _undo(self, call: Call[Any]) -> None:
        """Halt what a call has started that was cancelled while it ran."""
        if call.method in MOTION_METHODS and not call.stops:
            self.guarded(self.opened.halt)

    def _schedule(self, call: Call[Any]) -> None:
        """Hold a command until its start time; an invalid one is refused now and disturbs nothing."""
        try:
            (self._check_command if call.method == "send_cmd" else self._check_new_value)(*call.arguments)
        except EALError as error:
            call.fail(error)
            return
        self._scheduled.preempt(f"a newer command took over: {call.text()}")
        self._scheduled.hold(call)

    def _check_command(self, cmd: str, data: EALData | None) -> None:
        if self._info.commands:
            self._info.parse_command(cmd, data)

    def _check_new_value(self, data: EALData) -> None:
        if self._info.value is not None:
            self._info.value.check(data, "its value")

    def _preempt_motions(self, reason: str) -> None:
        self._scheduled.preempt(reason)
        self.close_motion(reason)

    def _send_cmd(self, cmd: str, data: EALData | None) -> Any:
        is_moving = self._motion is not None or self._scheduled.call is not None
        if is_moving and "send_cmd" in self._info.methods:  # otherwise it raises UnsupportedError and must stop nothing
            self._check_command(cmd, data)  # nor must an invalid command
            self._preempt_motions(f"a newer command took over: {cmd!r}")
        return converted(self.opened.send_cmd(cmd, data), status_of)

    def _set_value(self, data: EALData) -> Any:
        if "set_value" in self._info.methods:  # otherwise it raises UnsupportedError and must not stop a motion
            self._check_new_value(data)
            self._preempt_motions("a newer set_value took over")
        return converted(self.opened.set_value(data), status_of)

    def _send_req(self, req: str) -> Any:
        returns = self._info.parse_request(req)[0].returns if self._info.requests else None
        return converted(self.opened.send_req(req), lambda result: data_of(result, returns))

    def _get_config(self, key: str) -> Any:
        value = self._info.config(key).value if self._info.configs else None
        return converted(self.opened.get_config(key), lambda result: data_of(result, value))

    def _halt(self, reason: str | None = None) -> int:
        reason = reason if reason is not None else self.cell.explain("halted")
        self._preempt_motions(reason)
        self.close_exchanges(reason, lambda call: call.method in MOTION_METHODS)
        self.opened.halt()
        return 1

    def running(self) -> list[RunningCommand]:
        """Return the running commands. Thread: any."""
        return [
            RunningCommand(self.cell.name, command_of(call), call.caller or process_name(), since_s, call.progress())
            for call, since_s in self.commands()
        ]

    def stop_activity_of(self, call: Call[Any]) -> None:
        """Stop the activity of a call that nobody waits for. Thread: any; does not block."""
        self.run_soon(lambda: self._give_up(call))

    def _give_up(self, call: Call[Any]) -> None:
        self._scheduled.discard(call)
        self.stop_activity(call)
