"""The emergency stop of a robot, which holds it until it is resumed."""

from __future__ import annotations

import math
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, StoppedError, UnavailableError

SERVICE_ENDS: Final = "its server is being stopped"
"""Ends the error of a command that the end of its robot's service ended."""


def holds_robot(reason: str) -> str:
    """Return the clause that ends the error of a command that an emergency stop ended."""
    return f"an emergency stop holds the robot: {reason}"


class StopLatch:
    """The emergency stop of a robot: latched at once, and confirmed when the robot has halted. Thread: any.

    The end of a robot's service latches it too. That is no emergency: the robot is about to be unreachable.

    Attributes:
        reason: why motions are refused; None if they are not.
        emergency: the same of an emergency stop; None without one.
        is_confirmed: the robot has halted.
        stopped_s: the real time of the last stop, also of one that has ended; -inf before the first.
    """

    __slots__ = ("emergency", "is_confirmed", "reason", "stopped_s")

    def __init__(self) -> None:
        self.reason: str | None = None
        self.emergency: str | None = None
        self.is_confirmed = False
        self.stopped_s = -math.inf

    def set(self, reason: str) -> None:
        """Latch the stop; the first reason counts."""
        self.stopped_s = REAL_TIME.now()
        if self.reason is None:
            self.reason = self.emergency = reason or "no reason given"

    def end_service(self) -> None:
        """Latch the end of the robot's service, unless a stop is latched."""
        self.reason = self.reason or SERVICE_ENDS

    def confirm(self) -> None:
        """Record that the robot has halted, if the stop is still latched."""
        self.is_confirmed = self.reason is not None

    def clear(self) -> None:
        """Release the stop."""
        self.reason = self.emergency = None
        self.is_confirmed = False

    @property
    def explanation(self) -> str:
        """The end of the error of a command that the latched stop ended."""
        return holds_robot(self.emergency) if self.emergency is not None else str(self.reason)

    def overtaken(self, sent_s: float) -> EALError | None:
        """Return the error of a motion that was sent at a real time, if a stop came later; None else."""
        if sent_s > self.stopped_s:
            return None
        return StoppedError("an emergency stop came after it was sent") if self.reason is None else self.refusal()

    def refusal(self) -> EALError:
        """Return the error of a motion while the stop is latched."""
        if self.emergency is None:
            return UnavailableError(str(self.reason))
        return StoppedError(f"an emergency stop holds the robot until it is resumed: {self.reason}")
