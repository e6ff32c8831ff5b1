"""An actor that steps the activities of its resource from its own timers, one step at a time.

An activity is a generator (see `eal_actors.device.resource`). Because each step is a message of its own, the actor
answers status and stop while the robot moves, one thread touches all state, and a newer command or a stop closes the
generator, whose `finally` halts the motors.
"""

from __future__ import annotations

import contextlib
import math
import numbers
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import MOTION_METHODS, Call, ResourceCell
from eal_actors.actors.inbox import Inbox
from eal_actors.device.data.c_types import short_repr
from eal_actors.device.resource import Activity, Progress, Resource
from eal_actors.kernel import log
from eal_actors.kernel.clock import ROUNDING_S, Timer
from eal_actors.kernel.errors import (
    DeadlineError,
    EALError,
    PreemptedError,
    ResourceFaultError,
    ReturnTypeError,
    error_text,
)
from eal_actors.kernel.unwinding import AbandonedThread


class ScheduledCommand:
    """Holds the one command of a resource that waits for its start time.

    A timer of the actor's `inbox` starts it, by `start`. Thread: the resource's actor.
    """

    def __init__(self, inbox: Inbox, start: Callable[[Call[Any]], None]) -> None:
        self._inbox = inbox
        self._start = start
        self._timer: Timer | None = None
        self.call: Call[Any] | None = None

    def is_early(self, call: Call[Any]) -> bool:
        """Return whether a call's start time is still to come."""
        return call.start_s is not None and call.start_s - self._inbox.clock.now() > ROUNDING_S

    def hold(self, call: Call[Any]) -> None:
        """Hold a command until its start; one whose deadline comes before its start fails at once."""
        start_s, now_s = call.start_s or 0.0, self._inbox.clock.now()
        if call.deadline_s is not None and start_s >= call.deadline_s:
            late_s = start_s - call.deadline_s
            call.fail(DeadlineError(f"{call.text()} is to begin {late_s:g} s after its deadline; give it a later one"))
            return
        if call.begin_by_s is not None:  # its time limit counts from its start, not from its arrival
            call.begin_by_s += start_s - now_s
        self.call = call
        self._timer = self._inbox.call_at(start_s, self._ring)

    def _ring(self) -> None:
        call, self.call = self.call, None
        if call is not None:
            self._start(call)

    def preempt(self, reason: str) -> None:
        """Fail the waiting command, if there is one, with PreemptedError."""
        if (call := self.call) is not None:
            self.discard(call)
            call.fail(PreemptedError(reason))

    def discard(self, call: Call[Any]) -> None:
        """Do not start this command, because nobody waits for it."""
        if self.call is call:
            self.call = None
            if self._timer is not None:
                self._timer.cancel()


@dataclass(eq=False, slots=True)
class _ActivityRun:
    """A running activity and the call that it answers; the background activity answers none.

    `convert` makes the answer of the activity's result.
    """

    activity: Activity
    call: Call[Any] | None
    since_s: float = 0.0
    convert: Callable[[Any], Any] | None = None
    deadline_s: float = math.inf
    timer: Timer | None = None


class ActivityActor(EALActor):
    """The owner of one resource, as far as its activities go.

    At most one activity is a motion, which a newer one replaces. Any other call that takes time, such as a `get_value`
    or a `read_comm`, is an exchange: it disturbs no other activity, and any number of them run side by side. Thread:
    the actor's own, except where a method says otherwise.
    """

    def __init__(self, cell: ResourceCell, capacity: int) -> None:
        super().__init__(f"{cell.robot}/{cell.name}", cell.clock, capacity)
        self.cell = cell
        self.resource: Resource | None = None
        self.busy_until_s: float | None = None
        """The deadline of the running step; None while the actor is idle. Read by the robot."""
        self._log = log.get_logger(robot=cell.robot, resource=cell.name)
        self._motion: _ActivityRun | None = None
        self._exchanges: list[_ActivityRun] = []
        self._background: _ActivityRun | None = None

    @property
    def opened(self) -> Resource:
        """The resource; raises ResourceFaultError once it is closed."""
        if self.resource is None:
            raise ResourceFaultError("is closed")
        return self.resource

    @abstractmethod
    def busy(self, until_s: float) -> None:
        """Note the deadline of the step that begins."""

    def guarded(self, step: Callable[[], object]) -> bool:
        """Run a clean-up step; log its exception and return False, because the next step must run too."""
        try:
            step()
        except AbandonedThread:
            raise
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            name = getattr(step, "__name__", "")
            self._log.error("cleaning up failed", step=name, error=error_text(error), exc_info=log.debug_enabled)
            return False
        return True

    def explain(self, call: Call[Any], error: BaseException) -> EALError:
        """Return the error for the caller: it names the call and has the plugin's own exception as its cause."""
        self._log.debug("call failed", call=call.call_id, method=call.text(), error=error_text(error))
        if isinstance(error, EALError) and not isinstance(error, ReturnTypeError):
            return error
        what = f"{call.method} {call.arguments[0]!r}" if call.arguments else call.method
        if isinstance(error, ReturnTypeError):
            return ReturnTypeError(f"{what} {error.message}")
        fault = ResourceFaultError(f"{what} raised {error_text(error)}")
        fault.__cause__ = error
        return fault

    def calls(self) -> list[Call[Any]]:
        """Return the calls that activities answer. Thread: any."""
        return [run.call for run in self._runs() if run.call is not None]

    def commands(self) -> list[tuple[Call[Any], float]]:
        """Return the running commands and the times at which they began. Thread: any."""
        if self._motion is None and not self._exchanges:  # the usual case of a frequent question
            return []
        return [
            (run.call, run.since_s)
            for run in self._runs()
            if run.call is not None and run.call.method in MOTION_METHODS
        ]

    def begin(self, call: Call[Any], activity: Activity, convert: Callable[[Any], Any]) -> None:
        """Begin the activity that answers a call; `convert` makes the answer of its result."""
        run = _ActivityRun(activity, call, self.clock.now(), convert, call.deadline_s or 0.0)
        if call.method in ("send_cmd", "set_value"):
            self._motion = run
        else:
            self._exchanges.append(run)
        self._step(run)

    def begin_background(self, activity: Activity) -> None:
        """Begin the activity that runs as long as the resource does."""
        self._background = run = _ActivityRun(activity, None)
        self.actor_inbox.call_later(0.0, lambda: self._step(run))

    def stop_activity(self, call: Call[Any]) -> None:
        """Stop the activity that answers a call, and what it moved, because nobody waits for it."""
        if call not in self.calls():
            return
        reason = "its caller has given it up"
        self.busy(self.clock.now())  # its deadline has passed
        try:
            if self._motion is not None and self._motion.call is call:
                self.close_motion(reason)
            self.close_exchanges(reason, lambda other: other is call)
            if call.method in MOTION_METHODS:
                self.guarded(self.opened.halt)
        finally:
            self.busy_until_s = None

    def close_motion(self, reason: str) -> None:
        """Stop the motion; its call fails with PreemptedError."""
        run, self._motion = self._motion, None
        if run is not None:
            self._preempt(run, reason)

    def close_exchanges(self, reason: str, selects: Callable[[Call[Any]], bool]) -> None:
        """Stop the exchanges whose calls are selected; they fail with PreemptedError."""
        for run in [run for run in self._exchanges if run.call is not None and selects(run.call)]:
            self._remove(run)
            self._preempt(run, reason)

    def close_activities(self, reason: str) -> None:
        """Stop everything."""
        self.close_motion(reason)
        self.close_exchanges(reason, lambda _: True)
        if self._background is not None:
            self._close(self._background)
            self._background = None

    def _runs(self) -> list[_ActivityRun]:
        motion = self._motion
        return [*self._exchanges, *([motion] if motion is not None else [])]

    def _step(self, run: _ActivityRun) -> None:
        """Run an activity up to its next yield."""
        if not (run is self._motion or run is self._background or run in self._exchanges):
            return
        call, now_s = run.call, self.clock.now()
        if call is not None and now_s >= run.deadline_s - ROUNDING_S:  # timers may be early by that
            call.expire()
            self.stop_activity(call)
            return
        self.busy(min(now_s + self.cell.timeout_s, run.deadline_s))
        log.set_call(call.call_id if call is not None else None)
        resource = self.opened
        resource._reported_progress = None  # the report of an earlier call is not about this one
        try:
            delay_s = seconds_of(next(run.activity))
        except AbandonedThread:
            raise
        except StopIteration as end:
            self._finish(run, end.value)
        except BaseException as error:  # noqa: BLE001  # a plugin may raise anything
            self._fail(run, error)
        else:
            if call is not None and resource._reported_progress is not None:
                call.note_progress(Progress(*resource._reported_progress, now_s))
            run.timer = self.actor_inbox.call_at(min(now_s + delay_s, run.deadline_s), lambda: self._step(run))
        finally:
            self.busy_until_s = None
            log.set_call(None)

    def _finish(self, run: _ActivityRun, result: Any) -> None:
        if run is self._background:
            self._background = None
            return
        self._remove(run)
        if run.call is not None and run.convert is not None:
            try:
                run.call.set(run.convert(result))
            except ReturnTypeError as error:
                run.call.fail(self.explain(run.call, error))

    def _fail(self, run: _ActivityRun, error: BaseException) -> None:
        if run.call is None:
            raise error  # a poller that fails leaves the resource blind: the supervisor restarts it
        self._remove(run)
        self._close(run)
        if run.call.method in MOTION_METHODS:
            self.guarded(self.opened.halt)
        run.call.fail(self.explain(run.call, error))
        if not isinstance(error, Exception):
            raise error

    def _remove(self, run: _ActivityRun) -> None:
        if run is self._motion:
            self._motion = None
        else:
            self._exchanges.remove(run)

    def _preempt(self, run: _ActivityRun, reason: str) -> None:
        self._close(run)
        if run.call is not None:
            run.call.fail(PreemptedError(reason))

    def _close(self, run: _ActivityRun) -> None:
        if run.timer is not None:
            run.timer.cancel()
        if not self.guarded(run.activity.close) and self.resource is not None:
            self.guarded(self.resource.halt)  # its own `finally` did not do it


def status_of(result: Any) -> int:
    """Return a status int, where None counts as 1, the thesis's success; or raise ReturnTypeError."""
    if result is None:
        return 1
    if not isinstance(result, int) or not -(2**63) <= result < 2**63:  # more has no form on the network
        raise ReturnTypeError(f"returned {short_repr(result)} where a status int is wanted")
    return int(result)


def seconds_of(delay_s: object) -> float:
    """Return the delay that an activity yielded, in seconds, or raise ReturnTypeError."""
    with contextlib.suppress(OverflowError):
        if isinstance(delay_s, numbers.Real) and float(delay_s) >= 0:
            return float(delay_s)
    raise ReturnTypeError(f"yielded {short_repr(delay_s)} where seconds until its next step are wanted")
