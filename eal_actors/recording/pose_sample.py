"""Where a robot was, and when."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from operator import attrgetter
from typing import Final, NamedTuple

_ROUNDING_S: Final = 0.0005
"""Tables have times to a thousandth of a second."""


class PoseSample(NamedTuple):
    """A pose in the world frame, and when it was so, in seconds: of the fleet's clock, or since a run's start."""

    time_s: float
    x_m: float
    y_m: float
    yaw_rad: float


def stretches(path: Sequence[PoseSample], breaks_s: Sequence[float]) -> list[Sequence[PoseSample]]:
    """Return the parts of a path between the times at which nobody looked: from one to the next nothing is known.

    Args:
        path: samples in the order of time.
        breaks_s: the times at which a run that was cut off went on, in the same seconds, in order.
    """
    parts, first = [], 0
    for break_s in breaks_s:
        last = bisect_left(path, break_s - _ROUNDING_S, key=attrgetter("time_s"))
        parts.append(path[first:last])
        first = last
    return [part for part in (*parts, path[first:]) if part]
