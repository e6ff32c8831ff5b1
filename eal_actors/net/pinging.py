"""Pinger: makes of the answers to pings how a robot is, and how far its clock is from ours."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from eal_actors.actors.robot_view import MailboxLoad, Ping, RobotState
from eal_actors.kernel.errors import EALError, ProtocolError
from eal_actors.net.offset import Offset, OffsetEstimator
from eal_actors.net.wire import Answer, RobotTime

PING_TIMEOUT_S: Final = 2.0
"""Real seconds that a robot has for its answer."""


class Known(NamedTuple):
    """What the last answer told of a robot's clock.

    Attributes:
        era: the run of the robot's server.
        offset: of its clock.
        at_s: our time (REAL_TIME) for which the bound of the offset's error holds; after it, that grows by MAX_DRIFT.
    """

    era: str
    offset: Offset
    at_s: float


class Pinger:
    """Takes in the answers of one robot.

    Attributes:
        latest: what the last answer told; None before the first one. Read by any thread.

    Thread: any.
    """

    def __init__(self) -> None:
        self.latest: Known | None = None
        self._lock = threading.Lock()
        self._offsets = OffsetEstimator()
        self._era = ""

    def take(self, answer: Answer, time: RobotTime | None, sent_s: float, answered_s: float) -> Ping:
        """Return what the answer to a ping tells.

        Args:
            answer: what the robot answered.
            time: the robot's clock, as it came along.
            sent_s: our clock (REAL_TIME), read before the ping left.
            answered_s: our clock, read when the answer came.

        Raises:
            EALError: the robot answered with it; or the answer makes no sense.
        """
        if isinstance(answer, EALError):
            raise answer
        if not isinstance(answer, dict) or time is None:
            raise ProtocolError(f"a ping was answered by {answer!r}")
        received_s, replied_s = _time(answer, "received_s"), _time(answer, "replied_s")
        self._learn(time.era, sent_s, received_s, replied_s, answered_s)
        round_trip_s = max(0.0, answered_s - sent_s - (replied_s - received_s))
        return _ping_from(answer, round_trip_s, self.offset(answered_s))

    def note(self, time: RobotTime | None, sent_s: float, answered_s: float) -> None:
        """Learn the offset from any answer: roughly, as it does not tell how long the robot took."""
        if time is None:
            return
        with contextlib.suppress(ProtocolError):
            self._learn(time.era, sent_s, time.time_s, time.time_s, answered_s)

    def offset(self, at_s: float) -> Offset:
        """Return the robot's clock minus ours, as well as it is known.

        Args:
            at_s: our time (REAL_TIME) for which it is wanted.

        Raises:
            UnavailableError: nothing was answered yet.
        """
        with self._lock:
            return self._offsets.estimate(at_s)

    def _learn(self, era: str, sent_s: float, received_s: float, replied_s: float, answered_s: float) -> None:
        with self._lock:
            if era != self._era:  # the robot was restarted, and has another clock
                self._era = era
                self._offsets.forget()
            self._offsets.add(sent_s, received_s, replied_s, answered_s)
            self.latest = Known(era, self._offsets.estimate(answered_s), answered_s)


def _ping_from(answer: Mapping[str, Any], round_trip_s: float, offset: Offset) -> Ping:
    stopped = answer.get("stopped")
    try:
        return Ping(
            state=RobotState(answer.get("state")),
            release=str(answer["release"]),
            resources=int(answer["resources"]),
            stopped=None if stopped is None else str(stopped),
            holders=texts(answer["holders"]),
            holder_ids=texts(answer.get("holder_ids", {})),  # older robots do not tell
            round_trip_s=round_trip_s,
            offset_s=offset.offset_s,
            offset_error_s=offset.error_s,
            not_ready=texts(answer.get("not_ready", {})),
            mailboxes={
                str(name): MailboxLoad(int(count), float(oldest_s))
                for name, (count, oldest_s) in answer.get("mailboxes", {}).items()
            },
            restarts={str(name): int(count) for name, count in answer.get("restarts", {}).items()},
        )
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ProtocolError(f"a ping was answered in a way that makes no sense: {error!r}") from error


def texts(mapping: Mapping[Any, Any]) -> dict[str, str]:
    """Return what came over the wire as texts by the names of resources."""
    return {str(resource): str(text) for resource, text in mapping.items()}


def _time(answer: Mapping[str, Any], key: str) -> float:
    value = answer.get(key)
    if type(value) is not float:
        raise ProtocolError(f"a ping was answered with {key} {value!r}, which is no time")
    return value
