"""The order of frames round the ring, and where each one looks once all that is known of their shifts is weighed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np

from eal_actors.lab.panorama.cylinder import Floats
from eal_actors.lab.panorama.shift import Shift, wrapped_rad

_T = TypeVar("_T")

_ODOMETRY_SIGMA_RAD: Final = math.radians(3)
"""How far odometry is taken to be off about one turn: enough to give way to every picture."""
_AFTER: Final = 3
"""With how many frames that follow it each frame is compared."""

Links = Mapping[tuple[int, int], Shift]
"""How far apart frames are: for (first, second), the second being the one further to the right."""


@dataclass(frozen=True, slots=True)
class Ring:
    """Frames from left to right.

    Attributes:
        order: their numbers.
        turns_rad: how far to the right of each one the next one looks, and of the last one the first one.
        is_closed: whether the turn from the last to the first one is within the field of view too.
    """

    order: tuple[int, ...]
    turns_rad: tuple[float, ...]
    is_closed: bool

    def pairs(self, field_of_view_rad: float) -> Iterator[tuple[int, int]]:
        """Yield which frames are to be compared: those that overlap, and are not far from each other in the order."""
        number = len(self.order)
        for place, first in enumerate(self.order):
            turn_rad = 0.0
            for step in range(min(_AFTER, number - 1)):
                turn_rad += self.turns_rad[(place + step) % number]
                if turn_rad >= min(field_of_view_rad, math.pi):
                    break
                yield first, self.order[(place + step + 1) % number]

    def neighbours(self) -> Iterator[tuple[int, int, float]]:
        """Yield each frame, the next one, and the turn between them in radians; round the ring where it is closed."""
        number = len(self.order)
        for place in range(number if self.is_closed else number - 1):
            yield self.order[place], self.order[(place + 1) % number], self.turns_rad[place]


def ring_of(yaws_rad: Mapping[int, float], field_of_view_rad: float) -> Ring:
    """Return frames in order; what is no full ring begins behind the widest gap.

    Args:
        yaws_rad: where each frame looks, by its number; at least one.
        field_of_view_rad: of a frame.
    """
    order = sorted(yaws_rad, key=lambda number: (-(yaws_rad[number] % (2 * math.pi)), number))
    following = [*order[1:], order[0]]
    turns_rad = [(yaws_rad[one] - yaws_rad[other]) % (2 * math.pi) for one, other in zip(order, following, strict=True)]
    turns_rad[-1] = 2 * math.pi - math.fsum(turns_rad[:-1])  # all at one yaw: the way round, not nothing
    widest = max(range(len(order)), key=turns_rad.__getitem__)
    if turns_rad[widest] < field_of_view_rad:
        first = order.index(min(order))
        return Ring(_turned(order, first), _turned(turns_rad, first), is_closed=True)
    return Ring(_turned(order, widest + 1), _turned(turns_rad, widest + 1), is_closed=False)


def settle(
    yaws_rad: Mapping[int, float], ring: Ring, links: Links, px_per_rad: float
) -> dict[int, tuple[float, float]]:
    """Return where each frame looks: its yaw, and how far its axis is below the horizon, both in radians.

    Least squares over what pictures and odometry say. Round a closed ring the turns must add up to a full one: what is
    left over is spread like tension in springs, most of it where little is known.

    Args:
        yaws_rad: where odometry has each frame, by its number.
        ring: their order.
        links: how far apart frames are.
        px_per_rad: pixels of the cylinder in a radian.
    """
    rows: list[Floats] = []
    targets: list[tuple[float, float]] = []
    place = {number: index for index, number in enumerate(ring.order)}

    def tie(first: int, second: int, weight: float, left_over_rad: float, down_rad: float) -> None:
        row = np.zeros(len(place))
        row[place[second]] += weight
        row[place[first]] -= weight
        rows.append(row)
        targets.append((left_over_rad * weight, down_rad * weight))

    for first, second, _ in ring.neighbours():
        if first != second:
            tie(first, second, 1 / _ODOMETRY_SIGMA_RAD, 0.0, 0.0)
    for (first, second), shift in links.items():
        expected_rad = wrapped_rad(yaws_rad[first] - yaws_rad[second])
        left_over_rad = wrapped_rad(expected_rad - shift.right_px / px_per_rad)
        tie(first, second, px_per_rad / shift.sigma_px, left_over_rad, shift.down_px / px_per_rad)
    rows.append(np.ones(len(place)))  # on the average the frames stay where odometry has them, and level
    targets.append((0.0, 0.0))
    corrections, *_ = np.linalg.lstsq(np.array(rows), np.array(targets), rcond=None)
    return {number: (yaws_rad[number] + corrections[i, 0], corrections[i, 1]) for number, i in place.items()}


def closing_error_rad(ring: Ring, links: Links, px_per_rad: float) -> float | None:
    """Return how much more than a full turn the turns add up to, as the pictures tell them, and odometry the others.

    None where the ring is open, or the pictures tell less than half of the turns.
    """
    neighbours = list(ring.neighbours())
    seen = [links.get((first, second)) for first, second, _ in neighbours]
    if not ring.is_closed or 2 * sum(shift is not None for shift in seen) < len(seen):
        return None
    turns_rad = (
        turn_rad if shift is None else shift.right_px / px_per_rad
        for shift, (_, _, turn_rad) in zip(seen, neighbours, strict=True)
    )
    return math.fsum(turns_rad) - 2 * math.pi


def _turned(items: Sequence[_T], first: int) -> tuple[_T, ...]:
    return (*items[first:], *items[:first])
