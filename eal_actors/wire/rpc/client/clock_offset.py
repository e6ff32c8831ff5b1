"""ClockTracker: the offset of a robot's real time from ours, as pings measure it.

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
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from eal_actors.actors.robot_view import MailboxLoad, Ping, RobotState
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, ProtocolError, UnavailableError
from eal_actors.wire.format.messages import Answer, RobotTime
from eal_actors.wire.rpc.freshness import MAX_DRIFT

PING_PERIOD_S: Final = 10.0
PING_TIMEOUT_S: Final = 2.0
"""Real seconds until a ping fails."""
_ROUNDING_S: Final = 1e-6
"""More than the rounding error of clock readings, and less than any round trip through a network."""


@dataclass(frozen=True, slots=True)
class Offset:
    """Offset of a robot's clock: the robot's minus the controller's, wrong by at most `error_s` either way.

    Both are seconds.
    """

    offset_s: float
    error_s: float


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
        return Offset(best.offset_s, best.error_s(at_s))

    def forget(self) -> None:
        """Drop all pings: the robot was restarted and has another clock."""
        self._pings.clear()


class ClockEstimate(NamedTuple):
    """Offset of a robot's clock as of the last reply, in one run of its server; see Offset.

    `at_s` is our time (REAL_TIME) of the estimate; from then on its error grows by MAX_DRIFT.
    """

    era: str
    offset_s: float
    error_s: float
    at_s: float


class ClockTracker:
    """Tracks the clock of one robot. Thread: any.

    `latest` is None before the first reply. It is replaced as a whole, so it is read without the lock.
    """

    def __init__(self) -> None:
        self.latest: ClockEstimate | None = None
        self._lock = threading.Lock()
        self._offsets = OffsetEstimator()

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
        self._learn(time.era, sent_s, received_s, replied_s, answered_s)
        round_trip_s = max(0.0, answered_s - sent_s - (replied_s - received_s))
        return _ping_from(answer, round_trip_s, self.offset(answered_s))

    def note(self, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
        """Learn the offset from any reply: less precisely, since the robot's own share of the time is unknown."""
        if time is None:
            return
        with contextlib.suppress(ProtocolError):
            self._learn(time.era, sent_s, time.time_s, time.time_s, answered_s)

    def offset(self, at_s: float) -> Offset:
        """Return the robot's clock minus ours at a real time of ours; UnavailableError if no reply has arrived."""
        with self._lock:
            return self._offsets.estimate(at_s)

    def sent_s(self, time: RobotTime, arrived_s: float) -> tuple[float, float]:
        """Return when the robot sent a message, by our real time, and the greatest error of that.

        While the offset is unknown, these are the time of arrival and infinity.
        """
        known = self.latest
        if known is None or time.era not in ("", known.era):
            return arrived_s, math.inf
        error_s = known.error_s + MAX_DRIFT * max(0.0, arrived_s - known.at_s)
        return min(arrived_s, time.time_s - known.offset_s), error_s

    def localize(self, data: EALData, stamp_s: float, time: RobotTime, clock: Clock) -> float:
        """Set the stamp of a robot's value by our fleet's clock; returns the greatest error of that stamp."""
        sent_s, error_s = self.sent_s(time, REAL_TIME.now())
        data.restamp(clock.from_real(sent_s - time.time_s + stamp_s))
        return clock.of_real(error_s)

    def _learn(self, era: str, sent_s: float, received_s: float, replied_s: float, answered_s: float) -> None:
        with self._lock:
            if self.latest is None or era != self.latest.era:  # the robot was restarted and has another clock
                self._offsets.forget()
            self._offsets.add(sent_s, received_s, replied_s, answered_s)
            offset = self._offsets.estimate(answered_s)
            self.latest = ClockEstimate(era, offset.offset_s, offset.error_s, answered_s)


def _ping_from(answer: Mapping[str, Any], round_trip_s: float, offset: Offset) -> Ping:
    stopped = answer.get("stopped")
    try:
        return Ping(
            state=RobotState(answer.get("state")),
            release=str(answer["release"]),
            resources=int(answer["resources"]),
            stopped=None if stopped is None else str(stopped),
            holders=text_map(answer["holders"]),
            holder_ids=text_map(answer.get("holder_ids", {})),  # older robots send none
            round_trip_s=round_trip_s,
            offset_s=offset.offset_s,
            offset_error_s=offset.error_s,
            not_ready=text_map(answer.get("not_ready", {})),
            mailboxes={
                str(name): MailboxLoad(int(count), float(oldest_s))
                for name, (count, oldest_s) in answer.get("mailboxes", {}).items()
            },
            warnings=tuple(map(str, answer.get("warnings", ()))),
            restarts={str(name): int(count) for name, count in answer.get("restarts", {}).items()},
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"the answer to a ping is malformed: {error!r}") from error


def text_map(mapping: Mapping[Any, Any]) -> dict[str, str]:
    """Return a map of a message with its keys and values as text."""
    return {str(key): str(text) for key, text in mapping.items()}


def _time_field(answer: Mapping[str, Any], key: str) -> float:
    value = answer.get(key)
    if type(value) is not float:
        raise ProtocolError(f"a ping was answered with {key} {value!r}, which is not a time")
    return value
