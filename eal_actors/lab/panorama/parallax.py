"""Parallax: what a camera beside the axis of rotation sees, as it looks from the axis itself.

How far a thing is shifted depends on its distance. As long as features alone are known, the surroundings are a level
floor and upright walls, whose distance changes gradually from one overlap to the next; a map of distances follows from
the pixels (`depths`). Lengths are in heights of the camera above the floor: pictures alone determine no metres.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Attitude, CameraLens, Floats, Mask

KNOTS: Final = 24
"""Number of directions in which the distance of the walls is estimated."""
USUAL_NEARNESS: Final = 0.12
"""Of walls at 2.5 m, for a camera at 0.3 m."""


def knot_weights(yaws_rad: Any) -> Floats:
    """Return the share of each knot in the value at yaws (n,), by linear interpolation round the ring, (n, KNOTS)."""
    places = np.mod(np.asarray(yaws_rad), 2 * math.pi) * KNOTS / (2 * math.pi)
    before, rows = places.astype(int) % KNOTS, np.arange(len(places))
    weights = np.zeros((len(places), KNOTS))
    weights[rows, before] = 1 - places % 1
    weights[rows, (before + 1) % KNOTS] = places % 1
    return weights


@dataclass(frozen=True, slots=True, eq=False)
class DepthMap:
    """The distances of what stands round the axis of rotation.

    Attributes:
        nearness: inverse horizontal distance in each cell; columns from yaw 0 counter-clockwise, (rows, columns).
        top: tangent of the depression of the upper edge.
        row: height of a row, as a difference of tangents.
    """

    nearness: NDArray[np.float32]
    top: float
    row: float

    def at(self, yaws_rad: Floats, down: Floats) -> Floats:
        """Return the nearness at yaws (n,) and tangents of depression, (n,) or (m, 1), interpolated between cells."""
        ring = np.pad(self.nearness, ((0, 0), (1, 1)), mode="wrap")
        columns = np.mod(yaws_rad, 2 * math.pi) * self.nearness.shape[1] / (2 * math.pi) + 0.5
        x, y = np.broadcast_arrays(np.float32(columns), np.float32((down - self.top) / self.row - 0.5))
        found = cv2.remap(ring, np.atleast_2d(x), np.atleast_2d(y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(found, np.float64).reshape(x.shape)


@dataclass(frozen=True, slots=True, eq=False)
class Parallax:
    """The position of a camera, and what stands round it.

    Attributes:
        ahead: distance of the camera ahead of the axis, in camera heights.
        left: distance to the left of the axis, in camera heights.
        nearness: inverse distance of the walls from the axis, from yaw 0 counter-clockwise, (KNOTS,).
        depths: the same in more detail, for all that stands on the floor; None if it is not known.
    """

    ahead: float
    left: float
    nearness: Floats
    depths: DepthMap | None = None

    @classmethod
    def none(cls) -> Parallax:
        """Return that of a camera on the axis."""
        return cls(0.0, 0.0, np.full(KNOTS, USUAL_NEARNESS))

    @property
    def is_some(self) -> bool:
        """Whether the camera is beside the axis."""
        return bool(self.ahead or self.left)

    def seen_from_axis(self, right_rad: Floats, down: Floats, nearness: Floats) -> tuple[Floats, Floats]:
        """Return the directions from the axis in which things are that the camera sees in some directions.

        These are angles to the right of the camera's yaw and tangents of the depression, each with the nearness of the
        wall there.
        """
        forward, aside = np.cos(right_rad), -np.sin(right_rad)
        along = nearness * (self.ahead * forward + self.left * aside)
        reach = np.sqrt(np.maximum(along**2 - nearness**2 * (self.ahead**2 + self.left**2) + 1, 0.25)) - along
        near = np.maximum(nearness / reach, down)
        forward, aside = forward + near * self.ahead, aside + near * self.left
        return -np.arctan2(aside, forward), down / np.hypot(forward, aside)

    def seen_from_camera(self, right_rad: Floats, down: Floats, yaws_rad: Floats) -> tuple[Floats, Floats]:
        """Return the directions from the camera of things in directions from the axis: the inverse of `seen_from_axis`.

        They are angles to the right of the camera's yaw (n,), the same as yaws, and tangents of the depression, (n,)
        or (m, 1).
        """
        if not self.is_some:
            return right_rad, down
        walls = knot_weights(yaws_rad) @ self.nearness if self.depths is None else self.depths.at(yaws_rad, down)
        near = np.maximum(walls, down)
        forward, aside = np.cos(right_rad) - near * self.ahead, -np.sin(right_rad) - near * self.left
        return -np.arctan2(aside, forward), down / np.hypot(forward, aside)


class TurnedCamera(NamedTuple):
    """A camera on a robot that turns in place."""

    lens: CameraLens
    parallax: Parallax

    def pixels(self, right_rad: Floats, down: Floats, attitude: Attitude) -> tuple[Floats, Floats, Mask]:
        """Return the pixels of directions from the axis, as `CameraLens.pixels` does.

        They are angles to the right of the camera's yaw (n,), less than a quarter turn, and tangents of the depression,
        (n,) or (m, 1).
        """
        seen = self.parallax.seen_from_camera(right_rad, down, attitude.yaw_rad - right_rad)
        return self.lens.pixels(*seen, attitude)
