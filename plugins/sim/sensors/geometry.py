"""Intersections of lines on the floor with discs and rectangles, vectorised.

All arrays broadcast against each other. A line starts at an origin. `dx` and `dy` are the vector from there to the
centre of the shape; `ux` and `uy` are the unit direction of the line. A span is the distances along it to its entry and
exit, negative behind the origin; for a miss, the entry is greater than the exit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

Array: TypeAlias = "NDArray[np.float64]"
Span: TypeAlias = tuple[Array, Array]

_LEAST: Final = 1e-12
"""Replaces a direction component of 0, to avoid a division by zero for a line along a side."""


def disc_span_m(dx: Array, dy: Array, ux: Array, uy: Array, radius_m: Array) -> Span:
    """Return the spans of lines in discs."""
    along = ux * dx + uy * dy
    aside = ux * dy - uy * dx
    square = radius_m * radius_m - aside * aside
    half_chord = np.where(square >= 0.0, np.sqrt(np.maximum(square, 0.0)), -np.inf)
    return along - half_chord, along + half_chord


def rectangle_span_m(
    dx: Array, dy: Array, ux: Array, uy: Array, cos: Array, sin: Array, half_x_m: Array, half_y_m: Array
) -> Span:
    """Return the spans of lines in rectangles, whose x axes have the direction (cos, sin)."""
    enter_x, leave_x = _slab_span(cos * dx + sin * dy, cos * ux + sin * uy, half_x_m)
    enter_y, leave_y = _slab_span(cos * dy - sin * dx, cos * uy - sin * ux, half_y_m)
    return np.maximum(enter_x, enter_y), np.minimum(leave_x, leave_y)


def _slab_span(middle: Array, direction: Array, half: Array) -> Span:
    """Return the spans for one axis of a rectangle."""
    speed = np.maximum(np.abs(direction), _LEAST)
    towards = np.where(direction < 0.0, -middle, middle)
    return (towards - half) / speed, (towards + half) / speed
