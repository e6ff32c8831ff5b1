"""The replies to requests on a line that may lose, damage and delay them: which bytes are one, and whose they are.

Replies have the sizes of the requested groups and come in the order of their requests, without a number. If more than
one request may be unanswered, a reply belongs to the latest one that it can answer if it comes after the usual delay.
Otherwise it belongs to the oldest such one, and nothing more is asked until the others have had the same time: a wrong
pairing would go on forever.
"""

from __future__ import annotations

import enum
from collections import deque
from collections.abc import Callable, Sequence
from functools import cache
from typing import Final, NamedTuple

from .groups import GROUP_BYTES, is_group

QUIET_S: Final = 0.003
"""Silence after a whole reply; a byte more means that one was inserted."""
_SMOOTHING: Final = 0.125
_USUAL: Final = 2  # a delay up to this many usual ones is usual
_UNUSUAL_S: Final = 0.005
_DELAYS: Final = 4.0
_GROWTH: Final = 1.5
_LONGEST_S: Final = 1.0
_MOST_REQUESTS: Final = 16


class ReplyState(enum.Enum):
    """The state of the awaited reply."""

    AWAITED = enum.auto()
    WHOLE = enum.auto()
    DAMAGED = enum.auto()
    """Bytes are missing, or too many."""
    LOST = enum.auto()
    """Nothing has come within the time limit."""


class Request(NamedTuple):
    """One request: its sensor group and its time."""

    group: int
    asked_s: float


class Reply(NamedTuple):
    """One reply.

    Attributes:
        data: its bytes.
        asked_s: the time of its request, or of an earlier one.
        jitter_s: by how much it may be later than usual after that time.
    """

    group: int
    data: bytes
    asked_s: float
    jitter_s: float


def _match_oldest(requests: Sequence[Request], data: bytes) -> Sequence[Request] | None:
    """Return the oldest requests that bytes answer, in order; None if there are none."""
    is_reply = _reply_finder(data)

    @cache
    def match(place: int, start: int) -> tuple[Request, ...] | None:
        if start == len(data):
            return ()
        for number in range(place, len(requests)):
            request, end = requests[number], start + GROUP_BYTES[requests[number].group]
            if is_reply(request.group, start) and (others := match(number + 1, end)) is not None:
                return (request, *others)
        return None

    return match(0, 0)


def _match_latest(requests: Sequence[Request], data: bytes) -> Sequence[Request] | None:
    """Return the latest requests that bytes answer, in order; None if there are none."""
    is_reply = _reply_finder(data)

    @cache
    def match(count: int, end: int) -> tuple[Request, ...] | None:
        if end == 0:
            return ()
        for number in range(count - 1, -1, -1):
            request, start = requests[number], end - GROUP_BYTES[requests[number].group]
            if is_reply(request.group, start) and (others := match(number, start)) is not None:
                return (*others, request)
        return None

    return match(len(requests), len(data))


def _reply_finder(data: bytes) -> Callable[[int, int], bool]:
    """Return a function that tells whether a sensor group begins at a place of some bytes; it remembers its answers.

    After a pause of the line, the bytes of many requests have very many pairings.
    """

    @cache
    def is_reply(group: int, start: int) -> bool:
        return start >= 0 and is_group(group, data[start : start + GROUP_BYTES[group]])

    return is_reply


class ReplyReader:
    """Collects the replies to requests of sensor groups.

    Args:
        most_s: time limit of the first reply; later ones follow the measured delay.
        least_s: the shortest time limit.
        gap_s: the longest silence within a reply, more than QUIET_S.
        delays: time limit of a reply, in usual delays.

    Attributes:
        latest: the latest request.
        delay_s: usual time from a request to its reply; 0 until it is known.
    """

    def __init__(self, most_s: float, least_s: float, gap_s: float, delays: float = _DELAYS) -> None:
        self.delay_s = 0.0
        self._is_measured = False
        self._least_s, self._gap_s, self._delays = least_s, gap_s, delays
        self._limit_s = most_s
        self._held = bytearray()
        self._byte_s = 0.0
        self._unanswered: deque[Request] = deque(maxlen=_MOST_REQUESTS)
        self.latest = Request(0, 0.0)
        self._others_until_s = 0.0

    def ask(self, group: int, now_s: float) -> None:
        """Record a request."""
        while self._unanswered and now_s - self._unanswered[0].asked_s > _LONGEST_S:
            self._unanswered.popleft()
        self.latest = Request(group, now_s)
        self._unanswered.append(self.latest)

    @property
    def held(self) -> int:
        """Number of bytes received and not yet taken."""
        return len(self._held)

    def clear(self) -> None:
        """Forget all requests and bytes."""
        self._held.clear()
        self._unanswered.clear()
        self._others_until_s = 0.0

    def feed(self, data: bytes, now_s: float) -> None:
        """Take bytes that have arrived."""
        if data:
            self._held += data
            self._byte_s = now_s

    def state(self, now_s: float) -> ReplyState:
        """Return the state of the reply; LOST and DAMAGED end the wait for it."""
        held, silent_s = len(self._held), now_s - self._byte_s
        if not held:
            return ReplyState.LOST if now_s - self.latest.asked_s >= self._limit_s else ReplyState.AWAITED
        if silent_s < QUIET_S:
            return ReplyState.AWAITED
        is_whole = bool(self._answered())
        if not is_whole and silent_s < self._gap_s:
            return ReplyState.AWAITED
        return ReplyState.WHOLE if is_whole else ReplyState.DAMAGED

    def _answered(self) -> Sequence[Request]:
        """Return the requests that the bytes answer, oldest first; none if the bytes do not fit."""
        held, requests = bytes(self._held), [*self._unanswered] or [self.latest]
        is_usual = self._is_measured and self._byte_s - self.latest.asked_s <= _USUAL * self.delay_s + _UNUSUAL_S
        return (_match_latest if is_usual else _match_oldest)(requests, held) or ()

    def give_up(self, state: ReplyState) -> None:
        """End the wait for a reply that is LOST or DAMAGED."""
        if state is ReplyState.DAMAGED:
            self.clear()
        elif not self._is_measured:
            self._limit_s = min(_GROWTH * self._limit_s, _LONGEST_S)

    def take(self) -> list[Reply]:
        """Return the WHOLE replies, oldest first."""
        replies, start, answered = [], 0, self._answered()
        while self._unanswered and self._unanswered[0] not in answered:
            self._unanswered.popleft()  # they were lost
        for request in answered:
            if self._unanswered:
                self._unanswered.popleft()
            delay_s, end = self._byte_s - request.asked_s, start + GROUP_BYTES[request.group]
            data = bytes(self._held[start:end])
            replies.append(Reply(request.group, data, request.asked_s, self._jitter_s(delay_s)))
            start = end
            if self._unanswered:
                self._others_until_s = max(self._others_until_s, self._unanswered[-1].asked_s + delay_s)
            elif not self._others_until_s:
                self._measure(delay_s)
        self._held.clear()
        return replies

    def _jitter_s(self, delay_s: float) -> float:
        return max(0.0, delay_s - self.delay_s) if self._is_measured else 0.0

    def _measure(self, delay_s: float) -> None:
        share = _SMOOTHING if self._is_measured and delay_s <= _USUAL * self.delay_s else 1.0
        self._is_measured = True
        self.delay_s += share * (delay_s - self.delay_s)
        self._limit_s = min(max(self._least_s, self._delays * self.delay_s), _LONGEST_S)

    def awaits_others(self, now_s: float) -> bool:
        """Return whether other requests may still be answered; then nothing may be asked."""
        if self._unanswered and now_s < self._others_until_s:
            return True
        self._unanswered.clear()
        self._others_until_s = 0.0
        return False
