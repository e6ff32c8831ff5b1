"""Where straight lines over the floor enter and leave discs and rectangles, for many of each at once.

All arrays broadcast against each other. A line starts at an origin; `dx` and `dy` lead from there to the middle of the
shape, `ux` and `uy` are the line's direction, of length 1. Each span is the distances along the line to where it enters
and leaves, negative behind the origin; where the line misses, the entry comes after the exit.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Array: TypeAlias = "NDArray[np.float64]"
Span: TypeAlias = tuple[Array, Array]

_LEAST: Final = 1e-12
"""Stands for a direction's component of 0, so that a line along a side divides by something."""


def wrapped_rad(angle_rad: float) -> float:
    """Return the angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped


def disc_span_m(dx: Array, dy: Array, ux: Array, uy: Array, radius_m: Array) -> Span:
    """Return where lines enter and leave discs."""
    along = ux * dx + uy * dy
    aside = ux * dy - uy * dx
    square = radius_m * radius_m - aside * aside
    half_chord = np.where(square >= 0.0, np.sqrt(np.maximum(square, 0.0)), -np.inf)
    return along - half_chord, along + half_chord


def rectangle_span_m(
    dx: Array, dy: Array, ux: Array, uy: Array, cos: Array, sin: Array, half_x_m: Array, half_y_m: Array
) -> Span:
    """Return where lines enter and leave rectangles, whose x axes have the direction (cos, sin)."""
    enter_x, leave_x = _slab_span(cos * dx + sin * dy, cos * ux + sin * uy, half_x_m)
    enter_y, leave_y = _slab_span(cos * dy - sin * dx, cos * uy - sin * ux, half_y_m)
    return np.maximum(enter_x, enter_y), np.minimum(leave_x, leave_y)


def _slab_span(middle: Array, direction: Array, half: Array) -> Span:
    """Return the same for one axis alone, along which a rectangle is a slab."""
    speed = np.maximum(np.abs(direction), _LEAST)
    towards = np.where(direction < 0.0, -middle, middle)
    return (towards - half) / speed, (towards + half) / speed
