"""The activities of one resource, stepped from its actor's timers: a motion, exchanges of bytes, a background."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from eal_actors.actors.actor import AbandonedThread
from eal_actors.actors.answers import seconds_of, status_of
from eal_actors.actors.call import MOTION_METHODS, Call, ResourceCell
from eal_actors.actors.inbox import Inbox
from eal_actors.device.resource import Activity, Progress, Resource
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError, PreemptedError, ReturnTypeError
from eal_actors.kernel.log import set_call
from eal_actors.kernel.timers import Timer


@dataclass(eq=False)
class _Running:
    """An activity under way, and the call it answers; the background activity answers none."""

    activity: Activity
    call: Call[Any] | None
    since_s: float = 0.0
    answer: Callable[[Any], Any] = status_of
    """Makes the answer of what the activity returned."""
    timer: Timer | None = None


class ActivityHost(Protocol):
    """The actor whose thread the activities are stepped in. Thread: the actor's own.

    Attributes:
        clock: what its time is told by.
        actor_inbox: where its timers are.
        cell: the slot through which calls arrive.
        resource: what is stepped; None once it has ended.
        busy_until_s: when what runs now must be over; None while nothing runs.
    """

    clock: Clock
    actor_inbox: Inbox
    cell: ResourceCell
    resource: Resource | None
    busy_until_s: float | None

    @property
    def opened(self) -> Resource:
        """The resource; raises ResourceFaultError once it is closed."""
        ...

    def busy(self, until_s: float) -> None:
        """Note when what begins now must be over."""
        ...

    def guarded(self, step: Callable[[], object]) -> bool:
        """Run a clean-up step; whatever it raises is logged, and False returned."""
        ...

    def explained(self, call: Call[Any], error: BaseException) -> EALError:
        """Return an error as the call's caller is given it."""
        ...


class Activities:
    """Steps the activities of a resource, one step at a time.

    At most one is a motion, which a newer one takes over from. Any other call that waits, such as a `get_value` or a
    `read_comm`, is an exchange: it disturbs none, and any number of them go on beside one another.

    Args:
        host: the resource's actor.

    Thread: the actor's.
    """

    def __init__(self, host: ActivityHost) -> None:
        self._host = host
        self._motion: _Running | None = None
        self._exchanges: list[_Running] = []
        self._background: _Running | None = None

    @property
    def is_moving(self) -> bool:
        """Whether a motion is under way."""
        return self._motion is not None

    def calls(self) -> list[Call[Any]]:
        """Return the calls that activities answer. Thread: any."""
        return [running.call for running in self._under_way() if running.call is not None]

    def commands(self) -> list[tuple[Call[Any], float]]:
        """Return the commands under way, and the times at which they began. Thread: any."""
        if self._motion is None and not self._exchanges:  # as it mostly is, and as is asked often
            return []
        return [
            (running.call, running.since_s)
            for running in self._under_way()
            if running.call is not None and running.call.method in MOTION_METHODS
        ]

    def begin(self, call: Call[Any], activity: Activity, answer: Callable[[Any], Any]) -> None:
        """Begin the activity that answers a call; `answer` makes the answer of what it returns."""
        running = _Running(activity, call, self._host.clock.now(), answer)
        if call.method in ("send_cmd", "set_value"):
            self._motion = running
        else:
            self._exchanges.append(running)
        self._step(running)

    def begin_background(self, activity: Activity) -> None:
        """Begin the activity that runs as long as the resource does."""
        self._background = running = _Running(activity, None)
        self._host.actor_inbox.call_later(0.0, lambda: self._step(running))

    def give_up(self, call: Call[Any]) -> None:
        """Stop the activity that answers a call nobody waits for any more, and what it moved."""
        if call not in self.calls():
            return
        reason = PreemptedError("nobody waits for it any more")
        self._host.busy(self._host.clock.now())  # it is over its time already
        try:
            if self._motion is not None and self._motion.call is call:
                self.close_motion(reason)
            self.close_exchanges(reason, lambda other: other is call)
            if call.method in MOTION_METHODS:
                self._host.guarded(self._host.opened.halt)
        finally:
            self._host.busy_until_s = None

    def close_motion(self, reason: EALError) -> None:
        """Stop the motion, whose caller is given the reason."""
        running, self._motion = self._motion, None
        if running is not None:
            self._close(running)
            if running.call is not None:
                running.call.fail(reason)

    def close_exchanges(self, reason: EALError, ends: Callable[[Call[Any]], bool]) -> None:
        """Stop the exchanges for which `ends` holds."""
        for running in [running for running in self._exchanges if running.call is not None and ends(running.call)]:
            self._forget(running)
            self._close(running)
            if running.call is not None:
                running.call.fail(reason.copy())

    def close(self, reason: EALError) -> None:
        """Stop everything."""
        self.close_motion(reason)
        self.close_exchanges(reason, lambda _: True)
        if self._background is not None:
            self._close(self._background)
            self._background = None

    def _under_way(self) -> list[_Running]:
        motion = self._motion
        return [*self._exchanges, *([motion] if motion is not None else [])]

    def _step(self, running: _Running) -> None:
        """Run an activity up to its next yield."""
        if not (running is self._motion or running is self._background or running in self._exchanges):
            return
        call, now_s = running.call, self._host.clock.now()
        if call is not None and call.deadline_s is not None and now_s >= call.deadline_s:
            call.expire()
            self.give_up(call)
            return
        until_s = now_s + self._host.cell.timeout_s
        self._host.busy(min(until_s, call.deadline_s) if call is not None and call.deadline_s is not None else until_s)
        set_call(call.call_id if call is not None else None)
        resource = self._host.opened
        resource._told_progress = None  # what an earlier call told is not about this one
        try:
            delay_s = seconds_of(next(running.activity))
        except AbandonedThread:
            raise
        except StopIteration as end:
            self._finished(running, end.value)
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            self._failed(running, error)
        else:
            if call is not None and resource._told_progress is not None:
                call.note_progress(Progress(*resource._told_progress, now_s))
            next_s = now_s + delay_s
            if call is not None and call.deadline_s is not None:
                next_s = min(next_s, call.deadline_s)
            running.timer = self._host.actor_inbox.call_at(next_s, lambda: self._step(running))
        finally:
            self._host.busy_until_s = None
            set_call(None)

    def _finished(self, running: _Running, result: Any) -> None:
        if running is self._background:
            self._background = None
            return
        self._forget(running)
        if running.call is not None:
            try:
                running.call.set(running.answer(result))
            except ReturnTypeError as error:
                running.call.fail(self._host.explained(running.call, error))

    def _failed(self, running: _Running, error: BaseException) -> None:
        if running.call is None:
            raise error  # a poller that fails leaves the resource blind: the supervisor restarts it
        self._forget(running)
        self._close(running)
        if running.call.method in MOTION_METHODS:
            self._host.guarded(self._host.opened.halt)
        running.call.fail(self._host.explained(running.call, error))
        if not isinstance(error, Exception):
            raise error

    def _forget(self, running: _Running) -> None:
        if running is self._motion:
            self._motion = None
        else:
            self._exchanges.remove(running)

    def _close(self, running: _Running) -> None:
        if running.timer is not None:
            running.timer.cancel()
        if not self._host.guarded(lambda: running.activity.close()) and self._host.resource is not None:
            self._host.guarded(self._host.resource.halt)  # its own `finally` did not do it
