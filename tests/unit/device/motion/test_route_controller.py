"""RouteController drives a model of two wheels, with a delay, noise and wrong wheels, to its goals."""

from __future__ import annotations

import itertools
import math
from random import Random

import pytest

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.motion.route import Route
from eal_actors.device.motion.route_controller import (
    STANDSTILL,
    MotionLimits,
    PlanarTwist,
    RouteController,
    braking_speed,
)

LIMITS = MotionLimits(0.3, math.radians(90), 0.4, 3.0)
BRISK = MotionLimits(0.35, math.radians(90), 0.8, 5.33)
PERIOD_S, TICK_S = 0.05, 0.005


class Unicycle:
    """A robot whose wheels follow a twist with an acceleration, a delay of some periods, and wrong sizes."""

    def __init__(self, pose: tuple[float, float, float], delay: int, factors: tuple[float, float]) -> None:
        self.x_m, self.y_m, self.yaw_rad = pose
        self._factors = factors
        self._queue = [STANDSTILL] * delay
        self._speed_m_s = self._rate_rad_s = 0.0

    def drive(self, twist: PlanarTwist) -> None:
        self._queue.append(twist)
        speed_m_s, rate_rad_s = self._queue.pop(0)
        for _ in range(round(PERIOD_S / TICK_S)):
            self._speed_m_s += max(-0.8 * TICK_S, min(0.8 * TICK_S, speed_m_s - self._speed_m_s))
            self._rate_rad_s += max(-5 * TICK_S, min(5 * TICK_S, rate_rad_s - self._rate_rad_s))
            self.x_m += self._factors[0] * self._speed_m_s * TICK_S * math.cos(self.yaw_rad)
            self.y_m += self._factors[0] * self._speed_m_s * TICK_S * math.sin(self.yaw_rad)
            self.yaw_rad += self._factors[1] * self._rate_rad_s * TICK_S


class TwoWheels(Unicycle):
    """The same, but each wheel has its own limit of acceleration: a turn takes what braking needs."""

    TRACK_M, WHEEL_M_S2 = 0.3, 0.8

    def __init__(self) -> None:
        super().__init__((0.0, 0.0, 0.0), 0, (1.0, 1.0))
        self._wheels_m_s = [0.0, 0.0]

    def drive(self, twist: PlanarTwist) -> None:
        for _ in range(round(PERIOD_S / TICK_S)):
            for wheel, side in enumerate((-0.5, 0.5)):
                wanted_m_s = twist.speed_m_s + side * self.TRACK_M * twist.turn_rate_rad_s
                gain_m_s = self.WHEEL_M_S2 * TICK_S
                self._wheels_m_s[wheel] += max(-gain_m_s, min(gain_m_s, wanted_m_s - self._wheels_m_s[wheel]))
            left_m_s, right_m_s = self._wheels_m_s
            self.x_m += (left_m_s + right_m_s) / 2 * TICK_S * math.cos(self.yaw_rad)
            self.y_m += (left_m_s + right_m_s) / 2 * TICK_S * math.sin(self.yaw_rad)
            self.yaw_rad += (right_m_s - left_m_s) / self.TRACK_M * TICK_S


def run(
    robot: Unicycle, path: list[Point], yaw_rad: float | None, random: Random, limits: MotionLimits = LIMITS
) -> tuple[float, float, float]:
    """Drive along a path; return the largest distance from it, and the errors at its end in m and rad."""
    here = robot.x_m, robot.y_m
    controller, off_m, rest = RouteController(Route([here, *path]), yaw_rad, limits), 0.0, 0
    for _ in range(3000):
        noisy = random.gauss(robot.x_m, 0.001), random.gauss(robot.y_m, 0.001), random.gauss(robot.yaw_rad, 0.004)
        twist = controller.step(noisy, PERIOD_S)
        assert abs(twist.speed_m_s) <= limits.speed_m_s
        assert abs(twist.turn_rate_rad_s) <= limits.turn_rate_rad_s + 1e-9
        robot.drive(twist)
        legs = itertools.pairwise([here, *path])
        off_m = max(off_m, min(distance_m((robot.x_m, robot.y_m), *leg) for leg in legs))
        rest = rest + 1 if controller.is_at_goal else 0
        if rest == 6:
            return off_m, *controller.errors((robot.x_m, robot.y_m, robot.yaw_rad))
    raise AssertionError("it does not arrive")


def distance_m(point: Point, start: Point, end: Point) -> float:
    dx, dy = end[0] - start[0], end[1] - start[1]
    share = ((point[0] - start[0]) * dx + (point[1] - start[1]) * dy) / max(dx * dx + dy * dy, 1e-12)
    share = min(max(share, 0.0), 1.0)
    return math.hypot(point[0] - start[0] - share * dx, point[1] - start[1] - share * dy)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("factors", [(1.0, 1.0), (1.02, 0.83)])
def test_it_arrives_from_everywhere(delay: int, factors: tuple[float, float]) -> None:
    for seed in range(12):
        random = Random(seed)  # noqa: S311
        reach_m = 0.05 if seed % 4 == 0 else 2.0
        start = random.uniform(-reach_m, reach_m), random.uniform(-reach_m, reach_m), random.uniform(-4, 4)
        yaw_rad = random.uniform(-4, 4) if seed % 3 else None
        _, end_m, end_rad = run(Unicycle(start, delay, factors), [(0.0, 0.0)], yaw_rad, random)
        assert end_m < 0.01, f"seed {seed}"
        assert abs(end_rad) < math.radians(2), f"seed {seed}"


def stairs(step_m: float) -> list[Point]:
    """Return a way along the cells of a grid: a diagonal up, and one down."""
    legs = [(step_m, 0.0), (0.0, step_m)] * round(0.5 / step_m) + [(step_m, 0.0), (0.0, -step_m)] * round(0.5 / step_m)
    xs, ys = (itertools.accumulate(axis) for axis in zip(*legs, strict=True))
    return list(zip(xs, ys, strict=True))


def recorded(step_m: float, scatter_m: float) -> list[Point]:
    """Return a curve as a robot's own poses tell it."""
    random = Random(3)  # noqa: S311
    turns = [step * step_m for step in range(1, round(2 / step_m))]
    return [(random.gauss(math.sin(turn), scatter_m), random.gauss(1 - math.cos(turn), scatter_m)) for turn in turns]


@pytest.mark.parametrize(
    ("path", "most_m"),
    [
        ([(1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)], 0.03),
        ([(1.0, 0.0), (0.0, 0.02)], 0.03),
        ([(math.sin(step / 20), 1 - math.cos(step / 20)) for step in range(1, 100)], 0.01),
        (stairs(0.005), 0.015),
        (stairs(0.009), 0.015),
        (recorded(0.004, 0.001), 0.02),
        (recorded(0.02, 0.002), 0.02),
    ],
    ids=["square", "hairpin", "circle", "fine stairs", "stairs", "dense points", "points"],
)
def test_it_stays_on_its_path(path: list[Point], most_m: float) -> None:
    off_m, end_m, _ = run(Unicycle((0.0, 0.0, 0.0), 1, (1.0, 1.0)), path, None, Random(1))  # noqa: S311
    assert off_m < most_m
    assert end_m < 0.01


def test_it_stops_at_a_corner_before_it_turns() -> None:
    """A robot at a corner may be beside others: the margin between hulls is for what cannot be helped."""
    for seed in range(6):
        way = [(0.5, 0.0), (0.5, 0.5), (1.0, 0.5), (1.0, 0.0), (1.5, 0.0)]
        off_m, end_m, _ = run(TwoWheels(), way, None, Random(seed), BRISK)  # noqa: S311
        assert off_m < 0.01, f"seed {seed}"
        assert end_m < 0.01


def test_a_robot_can_stop_from_its_braking_speed() -> None:
    for left_m in (0.0, 0.01, 0.1, 1.0):
        speed_m_s = braking_speed(left_m, 0.2, 0.1)
        assert speed_m_s * 0.1 + speed_m_s**2 / (2 * 0.2) == pytest.approx(left_m)


def test_slowing_down_keeps_the_curve() -> None:
    controller = RouteController(Route([(0.0, 0.0), (1.0, 0.3)]), None, LIMITS)
    for _ in range(10):
        twist = controller.step((0.0, 0.0, 0.0), PERIOD_S)
    slow = controller.slow_down(0.01)
    assert slow.speed_m_s == pytest.approx(0.01)
    assert slow.turn_rate_rad_s / slow.speed_m_s == pytest.approx(twist.turn_rate_rad_s / twist.speed_m_s)
