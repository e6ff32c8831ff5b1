"""The actor that owns one resource: runs its calls, steps its activities, and keeps it safe."""

from __future__ import annotations

import contextlib
import math
import types
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from eal_actors.actors.activities import Activities
from eal_actors.actors.actor import AbandonedThread, EALActor
from eal_actors.actors.answers import comm_data_of, data_of, explained, status_of
from eal_actors.actors.call import MOTION_METHODS, Call, ResourceCell
from eal_actors.actors.readiness import Readiness
from eal_actors.actors.resource_factory import ResourceFactory
from eal_actors.actors.running import Running, command_of, process_name
from eal_actors.actors.starts import PendingStart
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.device.resource import Activity, Resource
from eal_actors.kernel.errors import (
    DeadlineError,
    EALError,
    PreemptedError,
    ResourceFaultError,
    ReturnTypeError,
    StaleCommandError,
    UnavailableError,
    shown,
)
from eal_actors.kernel.log import bind_work_place, get_logger, is_debugging, set_call


class _Later(NamedTuple):
    """A result that is still to come: the activity that gives it, and what makes the answer of it."""

    activity: Activity
    answer: Callable[[Any], Any]


def _now_or_later(result: Any, answer: Callable[[Any], Any]) -> Any:
    """Make the answer of a result, unless it is an activity, which gives the result later."""
    return _Later(result, answer) if type(result) is types.GeneratorType else answer(result)


class ResourceObserver(Protocol):
    """Whom a resource actor tells of its life: its robot. Thread: the resource's actor; none may block."""

    def resource_up(self, actor: ResourceActor, info: ResourceInfo) -> None:
        """The resource is open and serves calls."""
        ...

    def resource_ready(self, actor: ResourceActor, reason: str | None) -> None:
        """Its device can be used, or cannot for a reason."""
        ...

    def resource_down(self, actor: ResourceActor, error: BaseException | None) -> None:
        """The resource has ended: crashed with an error, or normally with None."""
        ...

    def watch(self, actor: ResourceActor, until_s: float) -> None:
        """Look at that time whether the actor is stuck in what it is doing now."""
        ...


class ResourceActor(EALActor):
    """Owns one resource: every touch of it happens in this actor's thread.

    Args:
        cell: the slot through which calls arrive.
        factory: makes and unmakes the resource.
        observer: told when the resource is up and when it is down.
        capacity: the most calls that may wait.
    """

    def __init__(self, cell: ResourceCell, factory: ResourceFactory, observer: ResourceObserver, capacity: int) -> None:
        super().__init__(f"{cell.robot}/{cell.name}", cell.clock, capacity)
        self.cell = cell
        self.resource: Resource | None = None
        self.busy_until_s: float | None = None
        """When what runs now must be over; None while the actor is idle. Read by the robot."""
        self.watched_until_s = math.inf
        """When the robot looks next whether the actor is stuck. Set to infinity by the robot before it looks."""
        self._factory = factory
        self._observer = observer
        self._is_open = False
        self._current: Call[Any] | None = None
        self._activities = Activities(self)
        self._readiness: Readiness | None = None
        self._pending = PendingStart(self.actor_inbox, self._execute)
        self._log = get_logger(robot=cell.robot, resource=cell.name)

    # Life.

    def on_start(self) -> None:
        """Make and open the resource. Thread: the actor's own."""
        bind_work_place(self.cell.robot, self.cell.name)
        self.busy(self.clock.now() + self.cell.timeout_s)
        try:
            self.resource = resource = self._factory.create()
            resource.name = self.cell.name
            resource.open()
            self._is_open = True
            info = resource.info()
            self._info = info
            self._methods = self._make_methods(resource, info)
            background = resource.background()
            if background is not None and type(background) is not types.GeneratorType:
                raise ReturnTypeError(f"background returned {background!r}, which is no generator")
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything; Pykka would hide it
            self.crash(error)
            return
        if type(resource).not_ready is not Resource.not_ready:  # most are always ready, and are not asked
            self._readiness = Readiness(resource, self.actor_inbox, self._tell_readiness, self._log)
            self._readiness.watch()
        self.busy_until_s = None
        if background is not None:
            self._activities.begin_background(background)
        self._observer.resource_up(self, info)

    def _tell_readiness(self, reason: str | None) -> None:
        self._observer.resource_ready(self, reason)

    def _make_methods(self, resource: Resource, info: ResourceInfo) -> dict[str, Callable[..., Any]]:
        """Return for each method what runs it and makes the answer of its result."""
        return {
            "get_status": lambda: status_of(resource.get_status()),
            "get_value": lambda: _now_or_later(resource.get_value(), lambda result: data_of(result, info.value)),
            "set_value": self._set_value,
            "send_req": self._send_req,
            "send_cmd": self._send_cmd,
            "read_comm": lambda length: _now_or_later(resource.read_comm(length), comm_data_of),
            "write_comm": lambda data, length: _now_or_later(resource.write_comm(data, length), status_of),
            "get_config": self._get_config,
            "set_config": lambda key, data: _now_or_later(resource.set_config(key, data), status_of),
            "halt": self._halt,
        }

    def shut_down(self) -> None:
        """Halt, close and stop, before anything that waits. Thread: any; does not block."""
        with contextlib.suppress(EALError):  # it has ended already
            self.actor_inbox.call_soon(self._shut_down)

    def _shut_down(self) -> None:
        self.actor_stopped.set()
        self._refuse(UnavailableError("the robot is being stopped"))
        self._stop()

    def on_crash(self, error: BaseException) -> None:
        """Stop what moves, let go, tell the robot. Thread: the actor's own."""
        try:
            self._end(PreemptedError(f"the resource crashed: {shown(error)}"))
        finally:
            self._observer.resource_down(self, error)

    def on_stop(self) -> None:
        """Stop what moves, whoever stopped the actor, and tell the robot. Thread: the actor's own."""
        self._end(PreemptedError("the resource is being stopped"))
        self._observer.resource_down(self, None)

    def abandon(self, error: EALError) -> None:
        """Fail the calls under way too; see EALActor."""
        under_way = [self._current, self._pending.call, *self._activities.calls()]
        super().abandon(error)
        for call in under_way:
            if call is not None:
                call.fail(error.copy())

    def on_abandoned(self) -> None:
        """Stop what moves after all, now that the stuck code is unwound. Thread: the actor's own."""
        self._end(PreemptedError("the resource was stuck and has been abandoned"))

    def _end(self, reason: EALError) -> None:
        self._pending.call_off(reason.copy())
        self._activities.close(reason)
        resource, self.resource = self.resource, None
        if resource is not None:
            if self._is_open:
                self.guarded(resource.halt)
                self.guarded(resource.close)
            self.guarded(lambda: self._factory.destroy(resource))

    def guarded(self, step: Callable[[], object]) -> bool:
        """Run a clean-up step; whatever it raises is logged, as the next must run too. Thread: the actor's own."""
        try:
            step()
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            name = getattr(step, "__name__", "")
            self._log.error("cleaning up failed", step=name, error=shown(error), exc_info=is_debugging())
            return False
        return True

    def busy(self, until_s: float) -> None:
        """Note when what begins now must be over, and see that the robot looks then: once, not for every call.

        Thread: the actor's own.
        """
        self.busy_until_s = until_s
        if until_s < self.watched_until_s:
            self.watched_until_s = until_s
            self._observer.watch(self, until_s)

    # Calls.

    def on_receive(self, message: Any) -> Any:
        """Run a call. Thread: the actor's own."""
        if isinstance(message, Call):
            self._execute(message)
            return None
        return super().on_receive(message)

    def _execute(self, call: Call[Any]) -> None:
        if call._done and not call.stops:  # the hot path: it was given up while it waited
            return
        deadline_s = call.deadline_s or 0.0
        if call.stops:  # a late stop is still a stop
            deadline_s = max(deadline_s, self.clock.now() + self.cell.timeout_s)
        elif deadline_s <= self.clock.now():
            call.fail(DeadlineError(f"{call.method} waited in the mailbox until its deadline; it was not executed"))
            return
        if call.begin_by_s is not None and self.clock.now() > call.begin_by_s and not call.stops:
            call.fail(StaleCommandError(f"{call.method} waited too long to be begun; it was not executed"))
            return
        if self.cell.latch.reason is not None and self.cell.latch.refuses(call):  # it passed the slot just before
            return
        if call.start_s is not None and not call.stops:
            if self._pending.is_early(call) and call.method in self._info.methods:
                self._hold(call)
                return
            call.began_s = self.clock.now()
        self._current = call
        self.busy(deadline_s)
        set_call(call.call_id)
        if is_debugging():
            self._log.debug("call", method=call.shown())
        if call.span is not None:
            handler = call.span.part(f"{self.cell.name}/{call.method} handler")
            call.link(lambda done, _: handler.end(done.exception()))
        try:
            if self._readiness is not None and not call.stops:
                self._readiness.require()
            result = self._methods[call.method](*call.arguments)
            if type(result) is _Later:
                self._activities.begin(call, *result)
            elif not call._finish(result, None) and call.method in MOTION_METHODS and not call.stops:
                self.guarded(self.opened.halt)  # it was given up while it ran
        except AbandonedThread:
            raise
        except Exception as error:  # noqa: BLE001  # a plugin may raise anything; the caller gets it
            if call.method in MOTION_METHODS and not isinstance(error, EALError):
                self.guarded(self.opened.halt)  # it may have set something off before it failed
            call.fail(self.explained(call, error))
        except BaseException as error:
            call.fail(self.explained(call, error))
            raise
        finally:
            self.busy_until_s = self._current = None
            set_call(None)

    def explained(self, call: Call[Any], error: BaseException) -> EALError:
        """Return an error as the call's caller is given it. Thread: the actor's own."""
        self._log.debug("call failed", call=call.call_id, method=call.shown(), error=shown(error))
        return explained(call, error)

    def _hold(self, call: Call[Any]) -> None:
        """Let a command wait for its start; one that would be refused then is refused now, and disturbs nothing."""
        try:
            (self._check_command if call.method == "send_cmd" else self._check_new_value)(*call.arguments)
        except EALError as error:
            call.fail(error)
            return
        self._pending.call_off(PreemptedError(f"a newer command took over: {call.shown()}"))
        self._pending.hold(call)

    def _check_command(self, cmd: str, data: EALData | None) -> None:
        if self._info.commands:
            self._info.parse_command(cmd, data)

    def _check_new_value(self, data: EALData) -> None:
        if self._info.value is not None:
            self._info.value.check(data, "its value")

    def _take_over(self, reason: PreemptedError) -> None:
        self._pending.call_off(reason.copy())
        self._activities.close_motion(reason)

    def _send_cmd(self, cmd: str, data: EALData | None) -> Any:
        if "send_cmd" in self._info.methods:  # else it raises UnsupportedError, and must not stop what runs
            if self._activities.is_moving or self._pending.call is not None:
                self._check_command(cmd, data)  # nor must a command that is refused
            self._take_over(PreemptedError(f"a newer command took over: {cmd!r}"))
        return self._started(self.opened.send_cmd(cmd, data))

    def _set_value(self, data: EALData) -> Any:
        if "set_value" in self._info.methods:  # else it raises UnsupportedError, and must not stop what runs
            self._check_new_value(data)
            self._take_over(PreemptedError("a newer set_value took over"))
        return self._started(self.opened.set_value(data))

    def _started(self, result: Any) -> Any:
        return _now_or_later(result, status_of)

    def _send_req(self, req: str) -> Any:
        returns = self._info.parse_request(req)[0].returns if self._info.requests else None
        return _now_or_later(self.opened.send_req(req), lambda result: data_of(result, returns))

    def _get_config(self, key: str) -> Any:
        value = self._info.config(key).value if self._info.configs else None
        return _now_or_later(self.opened.get_config(key), lambda result: data_of(result, value))

    def _halt(self) -> int:
        reason = PreemptedError("halted")
        self._take_over(reason)
        self._activities.close_exchanges(reason, lambda call: call.method in MOTION_METHODS)
        self.opened.halt()
        return 1

    @property
    def opened(self) -> Resource:
        """The resource; raises ResourceFaultError once it is closed. Thread: the actor's own."""
        if self.resource is None:
            raise ResourceFaultError("is closed")
        return self.resource

    def running(self) -> list[Running]:
        """Return the commands under way. Thread: any."""
        return [
            Running(self.cell.name, command_of(call), call.caller or process_name(), since_s, call.progress())
            for call, since_s in self._activities.commands()
        ]

    def stop_activity_of(self, call: Call[Any]) -> None:
        """Stop the activity that answers a call nobody waits for any more. Thread: any; does not block."""
        with contextlib.suppress(EALError):  # it has ended, and has stopped everything on its way out
            self.actor_inbox.call_soon(lambda: self._give_up(call))

    def _give_up(self, call: Call[Any]) -> None:
        self._pending.forget(call)
        self._activities.give_up(call)
