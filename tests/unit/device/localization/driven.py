"""A robot that drives at random with the errors that OdometryNoise describes: the truth, its odometry and its fixes.

Nothing here uses the filter's own equations: the wheels are stepped one by one, in short ticks.
"""

from __future__ import annotations

import math

import numpy as np

from eal_actors.device.localization.localizer import Localizer
from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import PoseEstimate, diagonal

TICK_S = 0.02


def stepped(pose: tuple[float, float, float], ahead_m: float, turn_rad: float) -> tuple[float, float, float]:
    x_m, y_m, yaw_rad = pose
    middle_rad = yaw_rad + turn_rad / 2
    return x_m + ahead_m * math.cos(middle_rad), y_m + ahead_m * math.sin(middle_rad), yaw_rad + turn_rad


class DrivenRobot:
    """The robot.

    Attributes:
        truth: its true pose.
        counted: its pose by odometry.
        past: the true poses by the number of the tick.
    """

    def __init__(self, noise: OdometryNoise, seed: int, fix_std: tuple[float, float] = (0.002, 0.006)) -> None:
        self.noise = noise
        self.random = np.random.default_rng(seed)
        self.truth = (0.0, 0.0, 0.0)
        self.counted = (0.0, 0.0, 0.0)
        self.now_s = 0.0
        self.past = [self.truth]
        self.fix_std = fix_std
        self.changes = True
        normal = self.random.standard_normal
        self.scale = noise.scale_share * normal()
        self.drift_rad_m = noise.drift_rad_m * normal()
        self.turns = noise.turn_share * normal()
        self.speed_m_s = self.turn_rate_rad_s = 0.0

    def drive(self) -> None:
        """Drive for a tick; now and then, change the speeds."""
        if self.changes and self.random.random() < 0.02:
            self.speed_m_s = self.random.uniform(-0.1, 0.4)
            self.turn_rate_rad_s = self.random.uniform(-1.5, 1.5)
        ahead_m, turn_rad = self.speed_m_s * TICK_S, self.turn_rate_rad_s * TICK_S
        arc_m = turn_rad * self.noise.track_m / 2
        left_m, right_m = (
            self.noise.scatter_m * math.sqrt(abs(wheel_m)) * self.random.standard_normal()
            for wheel_m in (ahead_m - arc_m, ahead_m + arc_m)
        )
        gone_m = ahead_m * (1 + self.scale) + (left_m + right_m) / 2
        turned_rad = turn_rad * (1 + self.turns) + ahead_m * self.drift_rad_m + (right_m - left_m) / self.noise.track_m
        self.truth = stepped(self.truth, gone_m, turned_rad)
        self.counted = stepped(self.counted, ahead_m, turn_rad)
        self.now_s = len(self.past) * TICK_S
        self.past.append(self.truth)

    def fix(self, late_ticks: int = 0) -> PoseEstimate:
        """Return a fix of the pose some ticks ago."""
        tick = max(0, len(self.past) - 1 - late_ticks)
        x_m, y_m, yaw_rad = self.past[tick]
        position_m, angle_rad = self.fix_std
        x, y, yaw = self.random.standard_normal(3)
        return PoseEstimate(
            x_m + position_m * x,
            y_m + position_m * y,
            yaw_rad + angle_rad * yaw,
            diagonal(*self.fix_std),
            tick * TICK_S,
        )

    def localizer(self) -> Localizer:
        localizer = Localizer("rob")
        localizer.attach(self.noise)
        localizer.odometry(*self.counted, self.now_s)
        return localizer

    def error(self, estimate: PoseEstimate) -> np.ndarray:
        """Return the error of an estimate of now."""
        x_m, y_m, yaw_rad = self.truth
        return np.array([estimate.x_m - x_m, estimate.y_m - y_m, math.remainder(estimate.yaw_rad - yaw_rad, math.tau)])

    def nees(self, estimate: PoseEstimate) -> float:
        """Return the normalised estimation error squared: chi-square with 3 degrees of freedom if consistent."""
        error = self.error(estimate)
        return float(error @ np.linalg.solve(np.array(estimate.covariance), error))
