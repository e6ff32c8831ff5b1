"""The extended Kalman filter of a robot's pose: pure functions on an immutable state.

The state is x, y, yaw and three constant errors of the odometry: of the scale of distances, of the turn per metre
ahead and of the scale of turns. Fixes correct both, so a tracked robot calibrates its own odometry; without fixes the
constant errors make the uncertainty grow with the distance. Matrices are lists of rows, because small boards have no
numpy; the sparse prediction takes about 20 us.

Source: T. Larsen et al., "Location Estimation for an Autonomously Guided Vehicle using an Augmented Kalman Filter to
Autocalibrate the Odometry", 1998; A. Martinelli et al., "Simultaneous Localization and Odometry Self Calibration for
Mobile Robot", 2007.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import Covariance, Pose, PoseEstimate, wrapped_rad

Matrix: TypeAlias = list[list[float]]

_SIZE: Final = 6
_WANDER: Final = 0.02
"""The constant errors change by this share of their standard deviations per metre or radian: floors differ."""

_GRAIN_M: Final = 0.00005
_GRAIN_RAD: Final = 0.0003
"""Added after each fix: encoders count whole steps, and a camera repeats its own error while a robot stands."""


@dataclass(frozen=True, slots=True)
class FilterState:
    """The state of the filter at one time; none of it may be changed.

    `mean` is x_m, y_m, yaw_rad (unwrapped), error of scale, turn per metre in rad/m, error of turns.
    """

    mean: tuple[float, float, float, float, float, float]
    covariance: Matrix

    @classmethod
    def at(cls, pose: Pose, covariance: Covariance, noise: OdometryNoise) -> FilterState:
        """Return the state of a robot at a pose, with unknown errors of its odometry."""
        errors = (noise.scale_share, noise.drift_rad_m, noise.turn_share)
        rows = [[*row, 0.0, 0.0, 0.0] for row in covariance]
        rows += [[std**2 if place == row + 3 else 0.0 for place in range(_SIZE)] for row, std in enumerate(errors)]
        return cls((*pose, 0.0, 0.0, 0.0), rows)

    def moved_to(self, pose: Pose, covariance: Covariance) -> FilterState:
        """Return the state at another pose; what is known of the odometry's errors is kept."""
        rows = [[*row, 0.0, 0.0, 0.0] for row in covariance]
        rows += [[0.0, 0.0, 0.0, *row[3:]] for row in self.covariance[3:]]
        return FilterState((*pose, *self.mean[3:]), rows)

    def estimate(self, stamp_s: float) -> PoseEstimate:
        """Return the pose with its covariance."""
        x_m, y_m, yaw_rad = self.mean[:3]
        xx, yy, tt = self.covariance[:3]
        rows = (xx[0], xx[1], xx[2]), (yy[0], yy[1], yy[2]), (tt[0], tt[1], tt[2])
        return PoseEstimate(x_m, y_m, wrapped_rad(yaw_rad), rows, stamp_s)


def between(before: Pose, after: Pose) -> Pose:
    """Return one pose as seen from another: ahead, to the left, and the turn in (-pi, pi]."""
    x_m, y_m = after[0] - before[0], after[1] - before[1]
    cos, sin = math.cos(before[2]), math.sin(before[2])
    return x_m * cos + y_m * sin, y_m * cos - x_m * sin, wrapped_rad(after[2] - before[2])


def beyond(before: Pose, motion: Pose) -> Pose:
    """Return the pose after a motion as `between` returns it."""
    cos, sin = math.cos(before[2]), math.sin(before[2])
    ahead_m, left_m, turn_rad = motion
    return before[0] + ahead_m * cos - left_m * sin, before[1] + ahead_m * sin + left_m * cos, before[2] + turn_rad


def predict(state: FilterState, motion: Pose, noise: OdometryNoise) -> FilterState:
    """Return the state after a short motion by the odometry, as `between` returns it."""
    ahead_m, left_m, turn_rad = motion
    if ahead_m == left_m == turn_rad == 0.0:
        return state
    x_m, y_m, yaw_rad, scale, drift, turns = state.mean
    length_m = ahead_m * math.cos(turn_rad / 2) + left_m * math.sin(turn_rad / 2)
    turned_rad = turn_rad * (1.0 + turns) + drift * length_m
    course_rad = yaw_rad + (turned_rad - turn_rad) / 2
    cos, sin = math.cos(course_rad), math.sin(course_rad)
    east_m, north_m = ahead_m * cos - left_m * sin, ahead_m * sin + left_m * cos
    gone_x_m, gone_y_m = east_m * (1.0 + scale), north_m * (1.0 + scale)
    slopes = (  # of x, y and yaw, by yaw, scale, drift and turns
        (-gone_y_m, east_m, -gone_y_m * length_m / 2, -gone_y_m * turn_rad / 2),
        (gone_x_m, north_m, gone_x_m * length_m / 2, gone_x_m * turn_rad / 2),
        (0.0, 0.0, length_m, turn_rad),
    )
    covariance = _transformed(state.covariance, slopes)
    _add_noise(covariance, noise, yaw_rad + turned_rad / 2, length_m, turn_rad)
    return FilterState((x_m + gone_x_m, y_m + gone_y_m, yaw_rad + turned_rad, scale, drift, turns), covariance)


def _transformed(covariance: Matrix, slopes: Sequence[Sequence[float]]) -> Matrix:
    """Return F P F', where F is the identity and, in its first three rows, the slopes by the last four states."""
    rows = [row[:] for row in covariance]
    _, _, by_yaw, by_scale, by_drift, by_turns = covariance
    for row, (yaw, scale, drift, turns) in zip(rows, slopes, strict=False):  # F P
        for column in range(_SIZE):
            row[column] += (
                yaw * by_yaw[column] + scale * by_scale[column] + drift * by_drift[column] + turns * by_turns[column]
            )
    for row in rows:  # and its product with F'
        _, _, at_yaw, at_scale, at_drift, at_turns = row
        for column, (yaw, scale, drift, turns) in enumerate(slopes):
            row[column] += yaw * at_yaw + scale * at_scale + drift * at_drift + turns * at_turns
    return rows


def _add_noise(covariance: Matrix, noise: OdometryNoise, course_rad: float, length_m: float, turn_rad: float) -> None:
    along, turn = noise.variances(length_m, turn_rad)
    cos, sin = math.cos(course_rad), math.sin(course_rad)
    covariance[0][0] += along * cos * cos
    covariance[0][1] += along * cos * sin
    covariance[1][0] += along * cos * sin
    covariance[1][1] += along * sin * sin
    covariance[2][2] += turn
    wander = _WANDER**2 * (abs(length_m) + abs(turn_rad))
    for place, std in enumerate((noise.scale_share, noise.drift_rad_m, noise.turn_share), start=3):
        covariance[place][place] += wander * std * std


def distance(state: FilterState, fix: PoseEstimate) -> float:
    """Return the squared Mahalanobis distance of a fix from the state: chi-square with 3 degrees of freedom."""
    innovation, inverse = _innovation(state, fix)
    return sum(innovation[row] * inverse[row][column] * innovation[column] for row in range(3) for column in range(3))


def update(state: FilterState, fix: PoseEstimate) -> FilterState:
    """Return the state corrected by a fix of the same time."""
    innovation, inverse = _innovation(state, fix)
    prior = state.covariance
    gain = [[sum(row[inner] * inverse[inner][column] for inner in range(3)) for column in range(3)] for row in prior]
    mean = [
        value + sum(gain[row][inner] * innovation[inner] for inner in range(3)) for row, value in enumerate(state.mean)
    ]
    posterior = [[0.0] * _SIZE for _ in range(_SIZE)]
    for row in range(_SIZE):
        for column in range(row, _SIZE):  # P - K H P, symmetric by construction
            value = prior[row][column] - sum(gain[row][inner] * prior[inner][column] for inner in range(3))
            posterior[row][column] = posterior[column][row] = value
    for place, std in enumerate((_GRAIN_M, _GRAIN_M, _GRAIN_RAD)):
        posterior[place][place] += std**2
    x_m, y_m, yaw_rad, scale, drift, turns = mean
    return FilterState((x_m, y_m, yaw_rad, scale, drift, turns), posterior)


def _innovation(state: FilterState, fix: PoseEstimate) -> tuple[Pose, Matrix]:
    """Return what a fix adds to the state, and the inverse of its covariance."""
    x_m, y_m, yaw_rad = state.mean[:3]
    innovation = fix.x_m - x_m, fix.y_m - y_m, wrapped_rad(fix.yaw_rad - yaw_rad)
    total = [[state.covariance[row][column] + fix.covariance[row][column] for column in range(3)] for row in range(3)]
    return innovation, _inverse(total)


def _inverse(matrix: Matrix) -> Matrix:
    """Return the inverse of a symmetric positive definite matrix of 3 rows."""
    (a, b, c), (_, d, e), (_, _, f) = matrix
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    bb, bc, cc = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * aa + b * ab + c * ac
    return [[value / determinant for value in row] for row in ((aa, ab, ac), (ab, bb, bc), (ac, bc, cc))]
