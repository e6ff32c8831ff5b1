"""Clocks: a fleet's clock, the real time of its process, and the offset of a robot's real time.

A fleet's clock may run at any rate; the network counts in real time (REAL_TIME). The offset of a robot's clock is
estimated from pings, with a bound on its error. A ping has four readings: the controller's clock at sending and at the
reply (`sent_s`, `answered_s`), and the robot's clock at receipt and at the reply (`received_s`, `replied_s`). The
robot's clock minus the controller's lies between `replied_s - answered_s` and `received_s - sent_s`, however the round
trip divides between the two ways. The estimate is the middle; its error is at most half the round trip.

Guarantees, if the clocks drift by at most MAX_DRIFT against each other and neither jumps:
- The true offset is within `offset_s ± error_s` at the time for which the estimate was asked. The bound grows by
  MAX_DRIFT with the age of the ping, so an old estimate never looks better than it is.
- The estimate is the one with the smallest bound among the last few pings: a fast ping is preferred to a newer slow
  one, until drift has used up its advantage.
- A jump of a clock (a restarted robot, a machine that slept) is detected as soon as a ping contradicts older ones by
  more than their bounds; the older ones are dropped.

Limit: a jump smaller than the bounds stays undetected until the older pings are forgotten.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from eal_actors.kernel.errors import ProtocolError, UnavailableError

MAX_DRIFT: Final = 500e-6
"""Drift of two clocks against each other, in seconds per second; quartz clocks stay well below."""

_ROUNDING_S: Final = 1e-6
"""More than the rounding error of clock readings, and less than any round trip through a network."""


@dataclass(frozen=True, slots=True)
class Offset:
    """Offset of a robot's clock: the robot's minus the controller's, wrong by at most `error_s` either way.

    `round_trip_s` is that of the ping that it comes from, without the robot's own share. All are seconds.
    """

    offset_s: float
    error_s: float
    round_trip_s: float


@dataclass(frozen=True, slots=True)
class _OffsetSample:
    """Offset measured by one ping, at `sent_s` of the controller's clock."""

    sent_s: float
    offset_s: float
    round_trip_s: float

    def error_s(self, now_s: float) -> float:
        """Return the greatest error at a time of the controller's clock, before or after the ping."""
        return max(self.round_trip_s, 0.0) / 2 + MAX_DRIFT * abs(now_s - self.sent_s)

    def contradicts(self, other: _OffsetSample, now_s: float) -> bool:
        """Return whether no offset is within the bounds of both."""
        return abs(self.offset_s - other.offset_s) > self.error_s(now_s) + other.error_s(now_s) + _ROUNDING_S


class OffsetEstimator:
    """Estimates one robot's clock offset from its replies to the last `size` pings. Thread: one at a time."""

    def __init__(self, size: int = 16) -> None:
        self._pings: deque[_OffsetSample] = deque(maxlen=size)

    def add(self, sent_s: float, received_s: float, replied_s: float, answered_s: float) -> None:
        """Add an answered ping, with its four readings; see above.

        Raises ProtocolError, and adds nothing, if they are impossible: a clock ran backwards, or the robot held the
        ping for longer than the whole round trip.
        """
        away_s = answered_s - sent_s
        round_trip_s = away_s - (replied_s - received_s)
        least_s = -MAX_DRIFT * away_s - _ROUNDING_S
        if not (received_s <= replied_s and least_s <= round_trip_s < math.inf):
            readings = f"sent {sent_s}, received {received_s}, replied {replied_s}, answered {answered_s}"
            raise ProtocolError(f"the clock readings of a ping are impossible, in seconds: {readings}")
        ping = _OffsetSample(sent_s, ((received_s - sent_s) + (replied_s - answered_s)) / 2, round_trip_s)
        for older in [older for older in self._pings if ping.contradicts(older, answered_s)]:
            self._pings.remove(older)
        self._pings.append(ping)

    def estimate(self, at_s: float) -> Offset:
        """Return the best estimate; UnavailableError if no ping has been answered.

        `at_s` is the controller's time for which the offset and its bound are wanted: now, or a future start.
        """
        if not self._pings:
            raise UnavailableError("the clock offset is unknown: no ping was answered yet")
        best = min(reversed(self._pings), key=lambda ping: ping.error_s(at_s))
        return Offset(best.offset_s, best.error_s(at_s), best.round_trip_s)

    def forget(self) -> None:
        """Drop all pings: the robot was restarted and has another clock."""
        self._pings.clear()
