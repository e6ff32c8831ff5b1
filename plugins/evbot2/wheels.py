"""The wheels as the firmware drives them: moves by the encoders, held speeds, and what stops them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from .body import Body
from .messages import Code, State, Verb, WheelStatus

MAX_TRAVEL_UM: Final = 100_000_000
"""Of a wheel in one move: 100 m."""

MIN_SPEED_UM_S: Final = 1000
HOLD_MS: Final = (20, 60_000)
"""How long speeds may be held."""

STALL_S: Final = 1.5
"""Driven wheels that count nothing for so long are stopped."""

_REST_S: Final = 0.06  # wheels that have counted nothing for so long stand
_RAMP_SHARE: Final = 0.8  # of the acceleration: so that both wheels ramp in proportion
_BRAKE_SHARE: Final = 0.45  # of the acceleration: less than half, so that the wheels follow to the very end
_CATCH_UP_HZ: Final = 4.0  # a wheel that lags behind its part of the way catches up at this rate
_CATCH_UP_SHARE: Final = 0.2  # of the speed, at most
_OFF_STEPS: Final = 1.5  # a move that ends so many encoder steps off, because a tick came late, is gone on with
_LATEST_S: Final = 0.5  # a tick that comes later than that is none to count on
_TRIES: Final = 3  # to end a move
_TICKS_TO_GO: Final = 2  # at the end, what is left is spread over at least so many ticks
_ROUNDING: Final = 1e-6
_UM: Final = 1e6


class Actuator(Protocol):
    """What a channel of the firmware moves."""

    @property
    def is_busy(self) -> bool:
        """Whether it has something to look after, and needs its ticks."""
        ...

    def accept(self, verb: Verb, numbers: Sequence[int], tag: int, now_s: float) -> Code:
        """Carry out an order, or say why not."""
        ...

    def tick(self, now_s: float) -> None:
        """Look after what moves."""
        ...

    def stop(self, state: State) -> None:
        """Stop, if it moves, and note why."""
        ...

    def status(self) -> tuple[int, ...]:
        """Return its numbers in the status."""
        ...


@dataclass(frozen=True, slots=True)
class WheelModel:
    """The wheels of a make.

    Attributes:
        track_m: nominal distance of the wheels.
        step_m: travel of a wheel from one count of its encoder to the next.
        max_speed_m_s: greatest speed of a wheel.
        acceleration_m_s2: of each wheel.
    """

    track_m: float
    step_m: float
    max_speed_m_s: float
    acceleration_m_s2: float


@dataclass(slots=True)
class _Move:
    """Travels of both wheels, which end at the same time; from rest to rest."""

    left_m: float
    right_m: float
    speed_m_s: float
    start: tuple[int, int] = (0, 0)  # what the encoders counted when the wheels stood
    ramp_m_s: float = 0.0  # how fast the faster wheel may be by now
    tries: int = 0
    is_begun: bool = False
    is_ending: bool = False

    @property
    def length_m(self) -> float:
        return max(abs(self.left_m), abs(self.right_m))

    def gone_m(self, counted: tuple[int, int], step_m: float) -> tuple[float, float]:
        """Return how far the wheels have gone since they stood."""
        return (counted[0] - self.start[0]) * step_m, (counted[1] - self.start[1]) * step_m

    def share(self, gone_m: tuple[float, float]) -> float:
        """Return which part of the whole both wheels have gone, over 1 if they went too far."""
        signs = math.copysign(1.0, self.left_m), math.copysign(1.0, self.right_m)
        return (signs[0] * gone_m[0] + signs[1] * gone_m[1]) / (abs(self.left_m) + abs(self.right_m))

    def speeds_m_s(self, fastest_m_s: float, gone_m: tuple[float, float]) -> tuple[float, float]:
        """Return the wheels' speeds, in proportion to their ways; the one that lags behind its part goes faster."""
        share, most_m_s = self.share(gone_m), _CATCH_UP_SHARE * abs(fastest_m_s)
        left_m_s, right_m_s = (
            fastest_m_s * way_m / self.length_m + max(-most_m_s, min(most_m_s, _CATCH_UP_HZ * (share * way_m - gone)))
            for way_m, gone in zip((self.left_m, self.right_m), gone_m, strict=True)
        )
        return left_m_s, right_m_s


class Wheels:
    """Both wheels: an Actuator.

    Args:
        body: what turns them and counts.
        model: of the make.
        tick_s: how often `tick` is called while it is busy, if it is not late.
    """

    def __init__(self, body: Body, model: WheelModel, tick_s: float) -> None:
        self._body = body
        self._model = model
        self._least_tick_s = self._tick_s = tick_s
        self._ticked_s = -math.inf
        self._order = 0
        self._state = State.IDLE
        self._move: _Move | None = None
        self._hold_until_s = -math.inf
        self._driven = (0.0, 0.0)
        self._counted = self._count()
        self._counted_s = -math.inf  # when they counted last

    @property
    def is_busy(self) -> bool:
        """See Actuator."""
        return self._state is State.MOVING

    def accept(self, verb: Verb, numbers: Sequence[int], tag: int, now_s: float) -> Code:
        """See Actuator."""
        if verb is Verb.STOP:
            self.stop(State.STOPPED)
            return Code.OK
        if not self._is_in_range(verb, numbers):
            return Code.RANGE
        self._order, self._state, self._counted_s, self._ticked_s = tag, State.MOVING, now_s, now_s
        if verb is Verb.MOVE:
            self._move = _Move(numbers[0] / _UM, numbers[1] / _UM, numbers[2] / _UM)
            self._drive(0.0, 0.0)
        else:
            self._move, self._hold_until_s = None, now_s + numbers[2] / 1000
            self._drive(numbers[0] / _UM, numbers[1] / _UM)
        self.tick(now_s)
        return Code.OK

    def tick(self, now_s: float) -> None:
        """See Actuator."""
        if not self.is_busy:
            return
        self._tick_s = min(max(now_s - self._ticked_s, self._least_tick_s), _LATEST_S)
        self._ticked_s = now_s
        if (counted := self._count()) != self._counted:
            self._counted, self._counted_s = counted, now_s
        if any(self._driven) and now_s - self._counted_s > STALL_S:
            self.stop(State.STALLED)
        elif self._move is not None:
            self._follow(self._move, now_s)
        elif now_s >= self._hold_until_s - _ROUNDING:
            self.stop(State.DONE)

    def stop(self, state: State) -> None:
        """See Actuator."""
        self._move = None
        self._drive(0.0, 0.0, always=True)
        if self._state is State.MOVING:
            self._state = state

    def status(self) -> WheelStatus:
        """See Actuator; the uptime is the firmware's to fill in."""
        left, right = self._count()
        return WheelStatus(0, self._order, self._state, _signed(left), _signed(right), int(self._body.strained()))

    def _follow(self, move: _Move, now_s: float) -> None:
        """Go on with a move: come to rest, go the way, come to rest."""
        stands = now_s - self._counted_s >= _REST_S - _ROUNDING
        if not move.is_begun:
            if not stands:
                return
            move.start, move.is_begun = self._counted, True
        gone_m = move.gone_m(self._counted, self._model.step_m)
        missing_m = move.length_m * (1 - move.share(gone_m)) if move.length_m else 0.0
        if move.is_ending:
            if not stands:
                return
            if abs(missing_m) < _OFF_STEPS * self._model.step_m or move.tries >= _TRIES:
                self.stop(State.DONE)
                return
            move.is_ending, move.ramp_m_s = False, 0.0
        if -_OFF_STEPS * self._model.step_m < missing_m < self._model.step_m / 4:  # two encoders tell half a step
            move.is_ending, move.tries, self._counted_s = True, move.tries + 1, now_s
            self._drive(0.0, 0.0)
            return
        if not any(self._driven):
            self._counted_s = now_s  # from here on they are driven, and have to count
        self._drive(*move.speeds_m_s(math.copysign(self._speed_m_s(move, abs(missing_m)), missing_m), gone_m))

    def _speed_m_s(self, move: _Move, missing_m: float) -> float:
        """Return how fast the wheel with the longer way is to go with so much of it left."""
        acceleration_m_s2 = self._model.acceleration_m_s2
        move.ramp_m_s += _RAMP_SHARE * acceleration_m_s2 * self._tick_s
        slowing_m_s = math.sqrt(2 * _BRAKE_SHARE * acceleration_m_s2 * missing_m)
        return min(move.speed_m_s, move.ramp_m_s, slowing_m_s, missing_m / (_TICKS_TO_GO * self._tick_s))

    def _drive(self, left_m_s: float, right_m_s: float, *, always: bool = False) -> None:
        if always or (left_m_s, right_m_s) != self._driven:
            self._driven = left_m_s, right_m_s
            self._body.drive(left_m_s, right_m_s)

    def _count(self) -> tuple[int, int]:
        left_m, right_m = self._body.travel_m()
        step_m = self._model.step_m
        return math.floor(left_m / step_m + _ROUNDING), math.floor(right_m / step_m + _ROUNDING)

    def _is_in_range(self, verb: Verb, numbers: Sequence[int]) -> bool:
        left, right, third = numbers
        most = round(self._model.max_speed_m_s * _UM)
        if verb is Verb.MOVE:
            return max(abs(left), abs(right)) <= MAX_TRAVEL_UM and MIN_SPEED_UM_S <= third <= most
        return verb is Verb.VEL and max(abs(left), abs(right)) <= most and HOLD_MS[0] <= third <= HOLD_MS[1]


def _signed(count: int) -> int:
    """Return a count modulo 2^32, from -2^31."""
    return (count + (1 << 31)) % (1 << 32) - (1 << 31)
