"""A model of a Roomba's wheels: what they travel by the commands that they get."""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple

_ACCELERATION_M_S2: Final = 0.8  # about that of a Roomba's wheels; the model learns it
_FACTOR: Final = 2.0  # by which a Roomba's acceleration may be another one
_LEARNT_FACTOR: Final = 1.5
_ALIKE: Final = 1.3  # a factor between two measurements that agree
_TELLING_M: Final = 0.008  # a difference of travel that tells accelerations apart
_MAX_SPEED_M_S: Final = 0.6
_HEARD: Final = 0.3  # share of a change of speed that may be left when a count confirms its command
ROUNDING_M: Final = 0.002  # of two counts in whole millimetres
_MOST_COMMANDS: Final = 64


class Travel(NamedTuple):
    """A travel of both wheels, or a speed.

    Attributes:
        ahead_m: their mean.
        arc_m: half their difference, right minus left.
    """

    ahead_m: float
    arc_m: float

    @classmethod
    def of_wheels(cls, left_m: float, right_m: float) -> Travel:
        """Return the travel of two wheels."""
        return cls((left_m + right_m) / 2, (right_m - left_m) / 2)

    @property
    def wheels_m(self) -> tuple[float, float]:
        """The travel of the left and of the right wheel."""
        return self.ahead_m - self.arc_m, self.ahead_m + self.arc_m

    def scaled(self, factor: float) -> Travel:
        """Return a multiple of it."""
        return Travel(factor * self.ahead_m, factor * self.arc_m)

    def plus(self, other: Travel, factor: float = 1.0) -> Travel:
        """Return the sum with a multiple of another travel."""
        return Travel(self.ahead_m + factor * other.ahead_m, self.arc_m + factor * other.arc_m)


NOTHING: Final = Travel(0.0, 0.0)


class Variant(NamedTuple):
    """Another possible course of the wheels.

    Attributes:
        factor: of the acceleration.
        late_s: delay of the commands.
        is_deaf: whether the latest command that no count confirms was lost.
    """

    factor: float = 1.0
    late_s: float = 0.0
    is_deaf: bool = False


LIKELY: Final = Variant()


class PredictedWheels:
    """Predicts the travel of the wheels from their speeds at a time, and the commands since then.

    Args:
        delay_s: by which a command may come late.

    Attributes:
        acceleration_m_s2: of each wheel, as far as is known.
        factor: by which it may be another one.
    """

    def __init__(self, delay_s: float = 0.0) -> None:
        self._delay_s = delay_s
        self.acceleration_m_s2, self.factor = _ACCELERATION_M_S2, _FACTOR
        self._at_s = -math.inf
        self._speeds_m_s = (0.0, 0.0)
        self._commands: deque[tuple[float, tuple[float, float]]] = deque([(-math.inf, (0.0, 0.0))], _MOST_COMMANDS)
        self._late_s = 0.0

    def command(self, speeds_m_s: tuple[float, float], now_s: float) -> None:
        """Record commanded speeds of the left and the right wheel."""
        if speeds_m_s != self._commands[-1][1]:
            self._commands.append((now_s, speeds_m_s))

    def delay(self, since_s: float, until_s: float, *, has_come: bool) -> None:
        """Record that the commands since a time have come between both times, or may not have come yet.

        If the last one has come, it has most likely come at the second time, and those before it have not.
        """
        if until_s - since_s < abs(self._late_s) and until_s > self._at_s:
            return
        self._late_s = until_s - since_s
        if has_come and self._late_s > 0 and self._commands[-1][0] >= since_s:
            before = [command for command in self._commands if command[0] < since_s]
            self._commands = deque([*before, (until_s, self.target_m_s)], _MOST_COMMANDS)
            self._late_s *= -1

    @property
    def target_m_s(self) -> tuple[float, float]:
        """The latest commanded speeds."""
        return self._commands[-1][1]

    def restart(self, at_s: float, speeds_m_s: tuple[float, float]) -> None:
        """Set the speeds at a time."""
        self._at_s, self._late_s = at_s, 0.0
        left_m_s, right_m_s = (max(-_MAX_SPEED_M_S, min(_MAX_SPEED_M_S, speed)) for speed in speeds_m_s)
        self._speeds_m_s = left_m_s, right_m_s
        while len(self._commands) > 1 and self._commands[1][0] <= at_s and self._is_heard():
            self._commands.popleft()

    def _is_heard(self) -> bool:
        """Return whether the speeds confirm the second command, or a later one followed it."""
        if len(self._commands) > 2 and self._commands[2][0] <= self._at_s:
            return True
        before, after = self._commands[0][1], self._commands[1][1]
        return all(
            abs(speed - end) <= _HEARD * abs(end - start)
            for speed, start, end in zip(self._speeds_m_s, before, after, strict=True)
        )

    def predict(self, from_s: float, to_s: float, variant: Variant = LIKELY) -> Travel:
        """Return the travel between two times."""
        left, right = (
            self._moved(wheel, to_s, variant)[0] - self._moved(wheel, from_s, variant)[0] for wheel in (0, 1)
        )
        return Travel.of_wheels(left, right)

    def speeds_m_s(self, at_s: float) -> tuple[float, float]:
        """Return the predicted speeds at a time."""
        left, right = (self._moved(wheel, at_s, LIKELY)[1] for wheel in (0, 1))
        return left, right

    def most_m_s(self, moved_m: float, duration_s: float) -> float:
        """Return the highest speed of a wheel at the end of a counted travel, if it never slowed down."""
        moved_m, gain_m_s = abs(moved_m) + ROUNDING_M / 4, self.acceleration_m_s2 * duration_s
        from_rest_m_s = math.sqrt(2 * self.acceleration_m_s2 * moved_m)
        return from_rest_m_s if from_rest_m_s <= gain_m_s else moved_m / duration_s + gain_m_s / 2

    @property
    def variants(self) -> tuple[Variant, ...]:
        """The accelerations that are possible, and the delays of commands."""
        delay_s = self._late_s if abs(self._late_s) > self._delay_s else self._delay_s
        less, root = 1 / self.factor, math.sqrt(self.factor)
        return (
            Variant(self.factor),
            Variant(root),
            Variant(less),
            Variant(1 / root),
            Variant(late_s=delay_s),
            Variant(root, delay_s),
            Variant(is_deaf=True),
        )

    def unknown(self, from_s: float, to_s: float) -> Travel:
        """Return by how much another acceleration, or a late command, changes a predicted travel."""
        likely = self.predict(from_s, to_s)
        others = [self.predict(from_s, to_s, variant) for variant in self.variants[:5:2]]
        return Travel(*(max(abs(other[place] - value) for other in others) for place, value in enumerate(likely)))

    def _moved(self, wheel: int, until_s: float, variant: Variant) -> tuple[float, float]:
        """Return one wheel's travel since the start, and its speed then."""
        at_s, speed_m_s, moved_m = self._at_s, self._speeds_m_s[wheel], 0.0
        if until_s <= at_s:
            return moved_m, speed_m_s
        acceleration_m_s2 = variant.factor * self.acceleration_m_s2
        ends_s = [time_s + variant.late_s for time_s, _ in self._commands]
        targets_m_s = [target[wheel] for _, target in self._commands]
        if variant.is_deaf:
            targets_m_s = [targets_m_s[0], *targets_m_s[:-1]]
        for target_m_s, end_s in zip(targets_m_s, [*ends_s[1:], until_s], strict=True):
            duration_s = min(until_s, end_s) - at_s
            if duration_s <= 0:
                continue
            lack_m_s = target_m_s - speed_m_s
            ramp_s = min(duration_s, abs(lack_m_s) / acceleration_m_s2)
            reached_m_s = speed_m_s + math.copysign(acceleration_m_s2 * ramp_s, lack_m_s)
            moved_m += (speed_m_s + reached_m_s) / 2 * ramp_s + reached_m_s * (duration_s - ramp_s)
            at_s, speed_m_s = at_s + duration_s, reached_m_s
        return moved_m, speed_m_s


class AccelerationGauge:
    """Measures the acceleration of the wheels by what they count from rest.

    Two measurements in a row must agree: a command that was lost makes wheels look slow.
    """

    def __init__(self) -> None:
        self._model = PredictedWheels()
        self._counted: Travel | None = None
        self._found = math.inf
        self._since_s = 0.0

    def command(self, speeds_m_s: tuple[float, float], now_s: float) -> None:
        """Record commanded speeds."""
        self._model.command(speeds_m_s, now_s)

    def cancel(self) -> None:
        """Wait for the next rest: a count is not certain."""
        self._counted = None

    def add(self, counted: Travel, now_s: float, model: PredictedWheels) -> None:
        """Add a certain count, and tell the model what is known by now."""
        if self._model.target_m_s == (0.0, 0.0):
            self._counted = None if any(counted) else NOTHING
            self._since_s = now_s
            self._model.restart(now_s, (0.0, 0.0))
            return
        if self._counted is None:
            return
        self._counted = self._counted.plus(counted)
        factors = [2.0 ** (power / 4) for power in range(-7, 8)]
        travels = [self._model.predict(self._since_s, now_s, Variant(factor)) for factor in factors]
        place = max((0, 1), key=lambda place: abs(travels[-1][place] - travels[0][place]))
        if abs(travels[-1][place] - travels[0][place]) < 4 * _TELLING_M:
            return
        wanted_m = self._counted[place]
        off_m, best = min(
            (abs(travel[place] - wanted_m), factor) for travel, factor in zip(travels, factors, strict=True)
        )
        before, self._found = self._found, best
        if off_m < ROUNDING_M and 1 / _ALIKE < best / before < _ALIKE:
            model.acceleration_m_s2, model.factor = _ACCELERATION_M_S2 * best, _LEARNT_FACTOR
        self._counted = None
