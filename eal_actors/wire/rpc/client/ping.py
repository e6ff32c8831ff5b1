"""ClockTracker: decodes replies to pings and tracks the offset of a robot's clock.

Readings of two runs of a robot's server are never combined: a new era drops the earlier ones, since the robot may have
another clock after a restart. `latest` is replaced as a whole, so every thread reads it without the lock. A reply comes
from another machine: a field of the wrong type is a ProtocolError.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from eal_actors.actors.robot_view import MailboxLoad, Ping, RobotState
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, ProtocolError
from eal_actors.wire.format.messages import Answer, RobotTime
from eal_actors.wire.rpc.clock_offset import MAX_DRIFT, Offset, OffsetEstimator

PING_PERIOD_S: Final = 10.0
PING_TIMEOUT_S: Final = 2.0
"""Real seconds until a ping fails."""


class ClockEstimate(NamedTuple):
    """Offset of a robot's clock as of the last reply, in one run of its server.

    `at_s` is our time (REAL_TIME) of the estimate; from then on its error grows by MAX_DRIFT.
    """

    era: str
    offset: Offset
    at_s: float


class ClockTracker:
    """Tracks the clock of one robot; `latest` is None before the first reply. Thread: any."""

    def __init__(self) -> None:
        self.latest: ClockEstimate | None = None
        self._lock = threading.Lock()
        self._offsets = OffsetEstimator()
        self._era = ""

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
        error_s = known.offset.error_s + MAX_DRIFT * max(0.0, arrived_s - known.at_s)
        return min(arrived_s, time.time_s - known.offset.offset_s), error_s

    def localize(self, data: EALData, stamp_s: float, time: RobotTime, clock: Clock) -> float:
        """Set the stamp of a robot's value by our fleet's clock; returns the greatest error of that stamp."""
        sent_s, error_s = self.sent_s(time, REAL_TIME.now())
        data.restamp(clock.from_real(sent_s - time.time_s + stamp_s))
        return clock.of_real(error_s)

    def _learn(self, era: str, sent_s: float, received_s: float, replied_s: float, answered_s: float) -> None:
        with self._lock:
            if era != self._era:  # the robot was restarted and has another clock
                self._era = era
                self._offsets.forget()
            self._offsets.add(sent_s, received_s, replied_s, answered_s)
            self.latest = ClockEstimate(era, self._offsets.estimate(answered_s), answered_s)


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
