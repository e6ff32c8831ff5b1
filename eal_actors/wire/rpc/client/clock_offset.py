"""ClockTracker: the offset of a robot's real time from ours, as pings measure it.

A fleet's clock may run at any rate; the network counts in real time (REAL_TIME). The offset of a robot's clock is
estimated from pings, with a bound on its error. A ping has four readings: the controller's clock at sending and at the
reply (`sent_s`, `answered_s`), and the robot's clock at receipt and at the reply (`received_s`, `replied_s`). The
robot's clock minus the controller's lies between `replied_s - answered_s` and `received_s - sent_s`, however the round
trip divides between the two ways. The estimate is the middle; its error is at most half the round trip.

Guarantees, if the clocks drift by at most MAX_DRIFT against each other and neither jumps:
- The true offset is within `offset_s ± error_s(at_s)`. The bound grows by MAX_DRIFT with the age of the ping, so an old
  estimate never looks better than it is.
- The estimate is the one with the smallest bound among the last few pings: a fast ping is preferred to a newer slow
  one, until drift has used up its advantage.
- A jump of a clock (a restarted robot, a machine that slept) is detected as soon as a ping contradicts older ones by
  more than their bounds; the older ones are dropped.

Readings of two runs of a robot's server are never combined: a new era drops the earlier ones, since the robot may have
another clock after a restart.

Limit: a jump smaller than the bounds stays undetected until the older pings are forgotten.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from eal_actors.actors.robot_view import Ping
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.wire.format.messages import Answer, RobotTime
from eal_actors.wire.rpc.client.handshake import ping_from
from eal_actors.wire.rpc.freshness import MAX_DRIFT

PING_PERIOD_S: Final = 10.0
PING_TIMEOUT_S: Final = 2.0
"""Real seconds until a ping fails."""
_ROUNDING_S: Final = 1e-6
"""More than the rounding error of clock readings, and less than any round trip through a network."""


class ClockOffset(NamedTuple):
    """Offset of a robot's clock: the robot's minus ours (REAL_TIME), as one exchange measured it; all are seconds.

    `era` is the run of the robot's server, `sent_s` our time of the question.
    """

    era: str
    sent_s: float
    offset_s: float
    round_trip_s: float

    def error_s(self, at_s: float) -> float:
        """Return the greatest error of the offset, either way, at a time of ours."""
        return max(self.round_trip_s, 0.0) / 2 + MAX_DRIFT * abs(at_s - self.sent_s)

    def agrees(self, other: ClockOffset, at_s: float) -> bool:
        """Return whether both measure one clock: it has not jumped or been replaced, as far as the bounds show."""
        apart_s = abs(self.offset_s - other.offset_s)
        return self.era == other.era and apart_s <= self.error_s(at_s) + other.error_s(at_s) + _ROUNDING_S


class ClockTracker:
    """Tracks the clock of one robot by the last `size` replies. Thread: any.

    `latest` is the best estimate, None before the first reply; it is replaced as a whole, and read without the lock.
    """

    def __init__(self, size: int = 16) -> None:
        self.latest: ClockOffset | None = None
        self._lock = threading.Lock()
        self._offsets: deque[ClockOffset] = deque(maxlen=size)

    def read_ping(self, answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> Ping:
        """Return the result of a ping, and learn the offset from it.

        Our clock (REAL_TIME) was read before the ping was sent and when the reply arrived. Raises EALError if the robot
        answered with it, or the answer is malformed.
        """
        if isinstance(answer, EALError):
            raise answer
        if not isinstance(answer, dict) or time is None:
            raise ProtocolError(f"a ping was answered by {answer!r}")
        received_s, replied_s = _time_field(answer, "received_s"), _time_field(answer, "replied_s")
        best = self.learn(time.era, sent_s, received_s, replied_s, answered_s)
        round_trip_s = max(0.0, answered_s - sent_s - (replied_s - received_s))
        measured = {"round_trip_s": round_trip_s, "offset_s": best.offset_s, "offset_error_s": best.error_s(answered_s)}
        return ping_from({**answer, **measured, "running": ()})

    def note(self, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
        """Learn the offset from any reply: less precisely, since the robot's own share of the time is unknown."""
        if time is None:
            return
        with contextlib.suppress(ProtocolError):
            self.learn(time.era, sent_s, time.time_s, time.time_s, answered_s)

    def known(self) -> ClockOffset:
        """Return the best estimate; UnavailableError if no reply has arrived."""
        if self.latest is None:
            raise UnavailableError("the clock offset is unknown: no ping was answered yet")
        return self.latest

    def sent_s(self, time: RobotTime, arrived_s: float) -> tuple[float, float]:
        """Return when the robot sent a message, by our real time, and the greatest error of that.

        While the offset is unknown, these are the time of arrival and infinity.
        """
        known = self.latest
        if known is None or time.era not in ("", known.era):
            return arrived_s, math.inf
        return min(arrived_s, time.time_s - known.offset_s), known.error_s(arrived_s)

    def localize(self, data: EALData, stamp_s: float, time: RobotTime, clock: Clock) -> float:
        """Set the stamp of a robot's value by our fleet's clock; returns the greatest error of that stamp."""
        sent_s, error_s = self.sent_s(time, REAL_TIME.now())
        data.restamp(clock.from_real(sent_s - time.time_s + stamp_s))
        return clock.of_real(error_s)

    def learn(self, era: str, sent_s: float, received_s: float, replied_s: float, answered_s: float) -> ClockOffset:
        """Add the four readings of an answered ping, see above; return the best estimate.

        Raises ProtocolError, and adds nothing, if they are impossible: a clock ran backwards, or the robot held the
        ping for longer than the whole round trip.
        """
        away_s = answered_s - sent_s
        round_trip_s = away_s - (replied_s - received_s)
        least_s = -MAX_DRIFT * away_s - _ROUNDING_S
        if not (received_s <= replied_s and least_s <= round_trip_s < math.inf):
            readings = f"sent {sent_s}, received {received_s}, replied {replied_s}, answered {answered_s}"
            raise ProtocolError(f"the clock readings of a ping are impossible, in seconds: {readings}")
        ping = ClockOffset(era, sent_s, ((received_s - sent_s) + (replied_s - answered_s)) / 2, round_trip_s)
        with self._lock:
            for older in [older for older in self._offsets if not ping.agrees(older, answered_s)]:
                self._offsets.remove(older)
            self._offsets.append(ping)
            self.latest = best = min(reversed(self._offsets), key=lambda offset: offset.error_s(answered_s))
        return best


def _time_field(answer: Mapping[str, Any], key: str) -> float:
    value = answer.get(key)
    if type(value) is not float:
        raise ProtocolError(f"a ping was answered with {key} {value!r}, which is not a time")
    return value
