"""PendingStart: the one command of a resource that waits for its time to begin."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from eal_actors.actors.call import Call
from eal_actors.actors.inbox import Inbox
from eal_actors.kernel.errors import DeadlineError, EALError
from eal_actors.kernel.timers import ROUNDING_S, Timer


class PendingStart:
    """Holds a command until it is to begin.

    Args:
        inbox: of the resource's actor, whose timer begins it.
        begin: begins a command; called in the actor's thread.

    Thread: the resource's actor.
    """

    def __init__(self, inbox: Inbox, begin: Callable[[Call[Any]], None]) -> None:
        self._inbox = inbox
        self._begin = begin
        self._call: Call[Any] | None = None
        self._timer: Timer | None = None

    @property
    def call(self) -> Call[Any] | None:
        """The command that waits."""
        return self._call

    def is_early(self, call: Call[Any]) -> bool:
        """Return whether a call has a time to begin that is still to come."""
        return call.start_s is not None and call.start_s - self._inbox.clock.now() > ROUNDING_S

    def hold(self, call: Call[Any]) -> None:
        """Let a command wait; one whose deadline comes before its start fails at once."""
        start_s, now_s = call.start_s or 0.0, self._inbox.clock.now()
        if call.deadline_s is not None and start_s >= call.deadline_s:
            late_s = start_s - call.deadline_s
            call.fail(DeadlineError(f"{call.shown()} is to begin {late_s:g} s after its deadline; give it a later one"))
            return
        if call.begin_by_s is not None:  # from its start on it is as urgent as it was from its coming on
            call.begin_by_s += start_s - now_s
        self._call = call
        self._timer = self._inbox.call_at(start_s, self._ring)

    def _ring(self) -> None:
        call, self._call = self._call, None
        if call is not None:
            self._begin(call)

    def call_off(self, reason: EALError) -> None:
        """Fail the command that waits, if there is one."""
        call = self._call
        self.forget(call)
        if call is not None:
            call.fail(reason)

    def forget(self, call: Call[Any] | None) -> None:
        """Do not begin this command: nobody waits for it any more."""
        if call is not None and self._call is call:
            self._call = None
            if self._timer is not None:
                self._timer.cancel()
