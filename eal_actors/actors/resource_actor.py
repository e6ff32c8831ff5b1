"""The actor that owns one resource: runs its calls, steps its activities, and keeps it safe."""

from __future__ import annotations

import contextlib
import math
import numbers
import types
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from eal_actors.actors.actor import AbandonedThread, EALActor
from eal_actors.actors.call import MOTION_METHODS, Call, ResourceCell
from eal_actors.actors.starts import PendingStart
from eal_actors.data import EALData
from eal_actors.errors import (
    DeadlineError,
    EALError,
    PreemptedError,
    ResourceFaultError,
    ReturnTypeError,
    StaleCommandError,
    UnavailableError,
    shown,
)
from eal_actors.info import ResourceInfo, ValueInfo
from eal_actors.log import bind_work_place, get_logger, is_debugging, set_call
from eal_actors.resource import Activity, Resource
from eal_actors.timers import Timer


class ResourceFactory(Protocol):
    """How to make and unmake the resource: what the plugin manager hands out."""

    def create(self) -> Resource:
        """Return a new resource. Thread: the resource's actor."""
        ...

    def destroy(self, resource: Resource) -> None:
        """Let go of it. Thread: the resource's actor."""
        ...


class ResourceObserver(Protocol):
    """Whom a resource actor tells of its life: its robot. Thread: the resource's actor; none may block."""

    def resource_up(self, actor: ResourceActor, info: ResourceInfo) -> None:
        """The resource is open and serves calls."""
        ...

    def resource_down(self, actor: ResourceActor, error: BaseException | None) -> None:
        """The resource has ended: crashed with an error, or normally with None."""
        ...

    def watch(self, actor: ResourceActor, until_s: float) -> None:
        """Look at that time whether the actor is stuck in what it is doing now."""
        ...


@dataclass(eq=False)
class _Running:
    """An activity under way, and the call it answers; the background activity answers none."""

    activity: Activity
    call: Call[Any] | None
    timer: Timer | None = None


def _status(result: Any) -> int:
    """Return a status int: None counts as 1, the thesis's success."""
    if result is None:
        return 1
    if isinstance(result, int):
        return int(result)
    raise ReturnTypeError(f"returned {result!r} where a status int is wanted")


def _seconds(delay_s: object) -> float:
    """Return what an activity yielded as seconds."""
    with contextlib.suppress(OverflowError):
        if isinstance(delay_s, numbers.Real) and float(delay_s) >= 0:
            return float(delay_s)
    raise ReturnTypeError(f"yielded {delay_s!r} where seconds until its next step are wanted")


def _data(result: Any, value: ValueInfo | None) -> EALData:
    """Return the result as EALData, checked against what the resource says of it."""
    try:
        data = EALData.of(result)
    except EALError as error:
        raise ReturnTypeError(f"returned what no EALData can hold: {error}") from error
    if value is not None and (problem := value.problem(data)):
        raise ReturnTypeError(f"returned a value that {problem}")
    return data


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
        self._motion: _Running | None = None
        self._background: _Running | None = None
        self._pending = PendingStart(self.actor_inbox, self._execute)
        self._log = get_logger(robot=cell.robot, resource=cell.name)

    # Life.

    def on_start(self) -> None:
        """Make and open the resource. Thread: the actor's own."""
        bind_work_place(self.cell.robot, self.cell.name)
        self._busy(self.clock.now() + self.cell.timeout_s)
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
        self.busy_until_s = None
        if background is not None:
            self._background = _Running(background, None)
            self.actor_inbox.call_later(0.0, lambda: self._step(self._background))
        self._observer.resource_up(self, info)

    def _make_methods(self, resource: Resource, info: ResourceInfo) -> dict[str, Callable[..., Any]]:
        """Return for each method what runs it and makes the answer of its result."""
        return {
            "get_status": lambda: _status(resource.get_status()),
            "get_value": lambda: _data(resource.get_value(), info.value),
            "set_value": self._set_value,
            "send_req": self._send_req,
            "send_cmd": self._send_cmd,
            "read_comm": lambda length: _data(resource.read_comm(length), None),
            "write_comm": lambda data, length: _status(resource.write_comm(data, length)),
            "get_config": self._get_config,
            "set_config": lambda key, data: _status(resource.set_config(key, data)),
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
        under_way = [self._current, self._motion.call if self._motion is not None else None, self._pending.call]
        super().abandon(error)
        for call in under_way:
            if call is not None:
                call.fail(error.copy())

    def on_abandoned(self) -> None:
        """Stop what moves after all, now that the stuck code is unwound. Thread: the actor's own."""
        self._end(PreemptedError("the resource was stuck and has been abandoned"))

    def _end(self, reason: EALError) -> None:
        self._pending.call_off(reason.copy())
        self._close_motion(reason)
        if self._background is not None:
            self._close_activity(self._background)
            self._background = None
        resource, self.resource = self.resource, None
        if resource is not None:
            if self._is_open:
                self._guarded(resource.halt)
                self._guarded(resource.close)
            self._guarded(lambda: self._factory.destroy(resource))

    def _guarded(self, step: Callable[[], object]) -> bool:
        """Run a clean-up step; whatever it raises is logged, because the next step must run too."""
        try:
            step()
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            name = getattr(step, "__name__", "")
            self._log.error("cleaning up failed", step=name, error=shown(error), exc_info=is_debugging())
            return False
        return True

    def _busy(self, until_s: float) -> None:
        """Note when what begins now must be over, and see that the robot looks then: once, not for every call."""
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
        self._busy(deadline_s)
        set_call(call.call_id)
        if is_debugging():
            self._log.debug("call", method=call.shown())
        try:
            result = self._methods[call.method](*call.arguments)
            if type(result) is types.GeneratorType:
                self._motion = _Running(result, call)
                self._step(self._motion)
            elif not call._finish(result, None) and call.method in MOTION_METHODS and not call.stops:
                self._guarded(self._opened.halt)  # it was given up while it ran
        except AbandonedThread:
            raise
        except Exception as error:  # noqa: BLE001  # a plugin may raise anything; the caller gets it
            if call.method in MOTION_METHODS and not isinstance(error, EALError):
                self._guarded(self._opened.halt)  # it may have set something off before it failed
            call.fail(self._explained(call, error))
        except BaseException as error:
            call.fail(self._explained(call, error))
            raise
        finally:
            self.busy_until_s = self._current = None
            set_call(None)

    def _explained(self, call: Call[Any], error: BaseException) -> EALError:
        """Return an error that names the call, and has the plugin's own error as its cause."""
        self._log.debug("call failed", call=call.call_id, method=call.shown(), error=shown(error))
        if isinstance(error, EALError) and not isinstance(error, ReturnTypeError):
            return error
        what = f"{call.method} {call.arguments[0]!r}" if call.arguments else call.method
        if isinstance(error, ReturnTypeError):
            return ReturnTypeError(f"{what} {error.message}")
        fault = ResourceFaultError(f"{what} raised {shown(error)}")
        fault.__cause__ = error
        return fault

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
        self._close_motion(reason)

    def _send_cmd(self, cmd: str, data: EALData | None) -> Any:
        if "send_cmd" in self._info.methods:  # else it raises UnsupportedError, and must not stop what runs
            if self._motion is not None or self._pending.call is not None:
                self._check_command(cmd, data)  # nor must a command that is refused
            self._take_over(PreemptedError(f"a newer command took over: {cmd!r}"))
        return self._started(self._opened.send_cmd(cmd, data))

    def _set_value(self, data: EALData) -> Any:
        if "set_value" in self._info.methods:  # else it raises UnsupportedError, and must not stop what runs
            self._check_new_value(data)
            self._take_over(PreemptedError("a newer set_value took over"))
        return self._started(self._opened.set_value(data))

    def _started(self, result: Any) -> Any:
        return result if type(result) is types.GeneratorType else _status(result)

    def _send_req(self, req: str) -> EALData:
        returns = self._info.parse_request(req)[0].returns if self._info.requests else None
        return _data(self._opened.send_req(req), returns)

    def _get_config(self, key: str) -> EALData:
        value = self._info.config(key).value if self._info.configs else None
        return _data(self._opened.get_config(key), value)

    def _halt(self) -> int:
        self._take_over(PreemptedError("halted"))
        self._opened.halt()
        return 1

    @property
    def _opened(self) -> Resource:
        if self.resource is None:
            raise ResourceFaultError("is closed")
        return self.resource

    # Activities.

    def stop_activity_of(self, call: Call[Any]) -> None:
        """Stop the activity that answers a call nobody waits for any more. Thread: any; does not block."""
        if call.method in MOTION_METHODS:
            with contextlib.suppress(EALError):  # it has ended, and has stopped everything on its way out
                self.actor_inbox.call_soon(lambda: self._give_up(call))

    def _give_up(self, call: Call[Any]) -> None:
        self._pending.forget(call)
        if self._motion is not None and self._motion.call is call:
            self._busy(self.clock.now())  # it is over its time already
            try:
                self._close_motion(PreemptedError("nobody waits for it any more"))
                self._guarded(self._opened.halt)
            finally:
                self.busy_until_s = None

    def _step(self, running: _Running | None) -> None:
        """Run an activity up to its next yield."""
        if running is None or (running is not self._motion and running is not self._background):
            return
        call, now_s = running.call, self.clock.now()
        if call is not None and call.deadline_s is not None and now_s >= call.deadline_s:
            call.expire()
            self._give_up(call)
            return
        until_s = now_s + self.cell.timeout_s
        self._busy(min(until_s, call.deadline_s) if call is not None and call.deadline_s is not None else until_s)
        set_call(call.call_id if call is not None else None)
        try:
            delay_s = _seconds(next(running.activity))
        except AbandonedThread:
            raise
        except StopIteration as end:
            self._finished(running, end.value)
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            self._failed(running, error)
        else:
            next_s = now_s + delay_s
            if call is not None and call.deadline_s is not None:
                next_s = min(next_s, call.deadline_s)
            running.timer = self.actor_inbox.call_at(next_s, lambda: self._step(running))
        finally:
            self.busy_until_s = None
            set_call(None)

    def _finished(self, running: _Running, result: Any) -> None:
        if running is self._background:
            self._background = None
            return
        self._motion = None
        if running.call is not None:
            try:
                running.call.set(_status(result))
            except ReturnTypeError as error:
                running.call.fail(self._explained(running.call, error))

    def _failed(self, running: _Running, error: BaseException) -> None:
        if running.call is None:
            raise error  # a poller that fails leaves the resource blind: the supervisor restarts it
        self._motion = None
        self._close_activity(running)
        self._guarded(self._opened.halt)
        running.call.fail(self._explained(running.call, error))
        if not isinstance(error, Exception):
            raise error

    def _close_motion(self, reason: EALError) -> None:
        running, self._motion = self._motion, None
        if running is not None:
            self._close_activity(running)
            if running.call is not None:
                running.call.fail(reason)

    def _close_activity(self, running: _Running) -> None:
        if running.timer is not None:
            running.timer.cancel()
        if not self._guarded(lambda: running.activity.close()) and self.resource is not None:
            self._guarded(self.resource.halt)  # its own `finally` did not do it
