"""How far a robot's clock is from the controller's, learnt from pings, with a bound on the error.

A ping yields four readings: the controller's clock when it was sent and when the answer came (`sent_s`,
`answered_s`), and the robot's clock when it came and when the answer left (`received_s`, `replied_s`). The robot's
clock minus the controller's then lies between `replied_s - answered_s` and `received_s - sent_s`, whatever share of
the round trip each way took. The middle is the estimate, half the round trip the bound of its error.

Guarantees, as long as the two clocks drift by at most MAX_DRIFT against each other and neither jumps:
- The true offset is within `offset_s ± error_s`, at the time for which the estimate was asked. The bound grows by
  MAX_DRIFT with the age of the ping, so an old estimate never looks better than it is.
- The estimate is the one with the least bound among the last few pings: a ping over a quick way beats a newer one that
  was held up, until drift has eaten what it was better by.
- A clock that jumped (a robot that restarted, a machine that slept) is noticed as soon as a ping contradicts older
  ones by more than their bounds: those are dropped.

Limits: a jump that is smaller than the bounds stays unseen until the older pings have left the memory.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

from eal_actors.kernel.errors import ProtocolError, UnavailableError

MAX_DRIFT: Final = 500e-6
"""By how many seconds in a second two clocks may drift apart; quartz clocks stay well within it."""

_ROUNDING_S: Final = 1e-6
"""More than what clock readings lose as floating-point numbers, and less than any round trip through a network."""


@dataclass(frozen=True, slots=True)
class Offset:
    """A robot's clock against the controller's.

    Attributes:
        offset_s: seconds to add to the controller's time to get the robot's.
        error_s: by how many seconds at most `offset_s` is wrong, either way.
        round_trip_s: how long the ping that told it was under way, without the robot's own share.
    """

    offset_s: float
    error_s: float
    round_trip_s: float


@dataclass(frozen=True, slots=True)
class _Ping:
    """What one ping told, by the controller's clock at `sent_s`."""

    sent_s: float
    offset_s: float
    round_trip_s: float

    def error_s(self, now_s: float) -> float:
        """Return the bound of the error at a time of the controller's clock, before or after the ping."""
        return max(self.round_trip_s, 0.0) / 2 + MAX_DRIFT * abs(now_s - self.sent_s)

    def contradicts(self, other: _Ping, now_s: float) -> bool:
        """Return whether no offset can be within the bounds of both."""
        return abs(self.offset_s - other.offset_s) > self.error_s(now_s) + other.error_s(now_s) + _ROUNDING_S


class OffsetEstimator:
    """Estimates one robot's clock offset from its answers to pings.

    Args:
        size: how many of the last pings to choose the best from, 1 or more.

    Thread: one at a time.
    """

    def __init__(self, size: int = 16) -> None:
        self._pings: deque[_Ping] = deque(maxlen=size)

    def add(self, sent_s: float, received_s: float, replied_s: float, answered_s: float) -> None:
        """Take in an answered ping.

        Args:
            sent_s: the controller's clock, read before the ping left.
            received_s: the robot's clock, read after the ping came.
            replied_s: the robot's clock, read before the answer left.
            answered_s: the controller's clock, read after the answer came.

        Raises:
            ProtocolError: no two clocks can have read so: one ran backwards, or the robot claims to have held the ping
                for longer than it was away. Nothing is taken in.
        """
        away_s = answered_s - sent_s
        round_trip_s = away_s - (replied_s - received_s)
        least_s = -MAX_DRIFT * away_s - _ROUNDING_S
        if not (received_s <= replied_s and least_s <= round_trip_s < math.inf):
            readings = f"sent {sent_s}, received {received_s}, replied {replied_s}, answered {answered_s}"
            raise ProtocolError(f"the clock readings of a ping make no sense, in seconds: {readings}")
        ping = _Ping(sent_s, ((received_s - sent_s) + (replied_s - answered_s)) / 2, round_trip_s)
        for older in [older for older in self._pings if ping.contradicts(older, answered_s)]:
            self._pings.remove(older)
        self._pings.append(ping)

    def estimate(self, at_s: float) -> Offset:
        """Return the best estimate.

        Args:
            at_s: the controller's time for which the offset is wanted: now, or a start to come. The error is bounded
                for that time.

        Raises:
            UnavailableError: no ping was answered yet.
        """
        if not self._pings:
            raise UnavailableError("the clock offset is unknown: no ping was answered yet")
        best = min(reversed(self._pings), key=lambda ping: ping.error_s(at_s))
        return Offset(best.offset_s, best.error_s(at_s), best.round_trip_s)

    def forget(self) -> None:
        """Drop all pings: the robot runs anew, with another clock."""
        self._pings.clear()
