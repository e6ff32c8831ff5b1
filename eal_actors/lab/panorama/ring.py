"""Order of the frames round the ring."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from eal_actors.lab.panorama.cylinder import Shift

_T = TypeVar("_T")

_AFTER: Final = 3  # number of following frames that each frame is compared with

Links = Mapping[tuple[int, int], Shift]
"""Measured shifts by (first, second) frame, where the second one is further to the right."""


@dataclass(frozen=True, slots=True)
class Ring:
    """Frames from left to right, with the turn to the right from each to the next, and from the last to the first.

    The ring `is_closed` if that last turn is within the field of view too.
    """

    order: tuple[int, ...]
    turns_rad: tuple[float, ...]
    is_closed: bool

    def pairs(self, field_of_view_rad: float) -> Iterator[tuple[int, int]]:
        """Yield the pairs of frames to compare: those that overlap and are close in the order."""
        number = len(self.order)
        for place, first in enumerate(self.order):
            turn_rad = 0.0
            for step in range(min(_AFTER, number - 1)):
                turn_rad += self.turns_rad[(place + step) % number]
                if turn_rad >= min(field_of_view_rad, math.pi):
                    break
                yield first, self.order[(place + step + 1) % number]

    def neighbours(self) -> Iterator[tuple[int, int, float]]:
        """Yield each frame, the next one, and the turn between them in radians; a closed ring wraps around."""
        number = len(self.order)
        for place in range(number if self.is_closed else number - 1):
            yield self.order[place], self.order[(place + 1) % number], self.turns_rad[place]


def ring_of(yaws_rad: Mapping[int, float], field_of_view_rad: float) -> Ring:
    """Return the frames in order; an open ring begins after the widest gap. There is at least one yaw."""
    order = sorted(yaws_rad, key=lambda number: (-(yaws_rad[number] % (2 * math.pi)), number))
    following = [*order[1:], order[0]]
    turns_rad = [(yaws_rad[one] - yaws_rad[other]) % (2 * math.pi) for one, other in zip(order, following, strict=True)]
    turns_rad[-1] = 2 * math.pi - math.fsum(turns_rad[:-1])  # if all have one yaw, a full turn and not 0
    widest = max(range(len(order)), key=turns_rad.__getitem__)
    if turns_rad[widest] < field_of_view_rad:
        first = order.index(min(order))
        return Ring(_rotated(order, first), _rotated(turns_rad, first), is_closed=True)
    return Ring(_rotated(order, widest + 1), _rotated(turns_rad, widest + 1), is_closed=False)


def closing_error_rad(ring: Ring, links: Links, px_per_rad: float) -> float | None:
    """Return the sum of the turns minus a full turn, with turns by shifts if measured, else by odometry.

    None if the ring is open, or if fewer than half of the turns are measured.
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


def _rotated(items: Sequence[_T], first: int) -> tuple[_T, ...]:
    return (*items[first:], *items[:first])
