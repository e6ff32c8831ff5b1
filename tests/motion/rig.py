"""Robots in lock step that know where they are: fixes with noise ten times a second, judged by the true pose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from random import Random
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.data import EALData
from eal_actors.testing import Simulation

DRIVERS: Final[Mapping[str, tuple[str, Mapping[str, Any]]]] = {
    "evbot2": ("evbot2", {"port": "sim://world/body"}),
    "evbot3": ("evbot3", {"address": "sim://world/body"}),
    "sci": ("roomba", {"protocol": "sci", "port": "sim://world/body"}),
    "oi": ("roomba", {"protocol": "oi", "port": "sim://world/body", "poll_hz": 20}),
}
"""The drivers of real robots: the model of the body behind their emulators, and their settings."""
FIX_S: Final = 0.1
FIX_M: Final = 0.001
"""Standard deviation of a fix."""
FIX_RAD: Final = math.radians(0.25)


class TrackedRobot:
    """A robot that gets fixes of its pose.

    Args:
        simulation: open.
        robot: the robot to command.
        body: the name of the robot whose true pose counts.
        seed: of the noise of the fixes.
    """

    def __init__(self, simulation: Simulation, robot: RobotHandle, body: str, seed: int) -> None:
        self.simulation = simulation
        self.robot = robot
        self.body = simulation[body]
        self._random = Random(seed)  # noqa: S311
        self.is_tracked = True

    def true_pose(self) -> tuple[float, float, float]:
        x_m, y_m, yaw_rad = map(float, self.body["TruePose"].get_value().get().value)
        return x_m, y_m, yaw_rad

    def fix(self) -> None:
        """Give the robot a fix: its true pose, with noise and a covariance, as a tracker does."""
        x_m, y_m, yaw_rad = self.true_pose()
        gauss = self._random.gauss
        pose = [x_m + gauss(0, FIX_M), y_m + gauss(0, FIX_M), yaw_rad + gauss(0, FIX_RAD)]
        covariance = [FIX_M**2, 0.0, 0.0, 0.0, FIX_M**2, 0.0, 0.0, 0.0, FIX_RAD**2]
        data = EALData.of(pose + covariance, frame_id="map", stamp_s=self.simulation.now_s)
        self.robot["Pose"].send_cmd("fix", data).get()

    def until_done(self, motion: Future[Any], most_s: float = 120.0) -> BaseException | None:
        """Advance time, with fixes, until a motion ends; return its failure."""
        end_s = self.simulation.now_s + most_s
        while not motion.done():
            assert self.simulation.now_s < end_s, f"{motion!r} after {most_s} s at {self.true_pose()}"
            self.advance_tracked(FIX_S)
        return motion.exception()

    def until_moving(self, motion: Future[Any]) -> None:
        """Advance time until the robot has moved by 0.2 m."""
        x_m, y_m, _ = self.true_pose()
        while math.dist(self.true_pose()[:2], (x_m, y_m)) < 0.2:
            assert not motion.done(), motion.exception()
            self.advance_tracked(FIX_S)

    def advance_tracked(self, duration_s: float) -> None:
        """Advance time, with fixes."""
        for _ in range(round(duration_s / FIX_S)):
            if self.is_tracked:
                self.fix()
            self.simulation.advance(FIX_S)

    def errors(self, x_m: float, y_m: float, yaw_deg: float | None) -> tuple[float, float]:
        """Return the distance of the true pose from a goal in m, and its angle in degrees."""
        true_x, true_y, true_yaw = self.true_pose()
        off_rad = 0.0 if yaw_deg is None else math.remainder(true_yaw - math.radians(yaw_deg), math.tau)
        return math.hypot(true_x - x_m, true_y - y_m), abs(math.degrees(off_rad))


@contextmanager
def tracked(kind: str, seed: int, world: object = None, **settings: Any) -> Iterator[TrackedRobot]:
    """Open a simulation with one robot: a model of the simulation, or a driver of DRIVERS at an emulator."""
    body = {"start": (0.0, 0.0, 0.0), **settings}
    if kind not in DRIVERS:
        with Simulation({"body": {"model": kind.removeprefix("sim-"), **body}}, world, seed=seed) as simulation:  # type: ignore[arg-type]
            yield TrackedRobot(simulation, simulation["body"], "body", seed)
        return
    model, driver = DRIVERS[kind]
    robots = {"body": {"model": model, **body}, "robot": {"plugins": {model: dict(driver)}}}
    with Simulation(robots, world, seed=seed) as simulation:  # type: ignore[arg-type]
        yield TrackedRobot(simulation, simulation["robot"], "body", seed)


def random_goal(random: Random, reach_m: float = 1.5) -> tuple[float, float, float]:
    return random.uniform(-reach_m, reach_m), random.uniform(-reach_m, reach_m), random.uniform(-180.0, 180.0)


def worst(errors: Sequence[tuple[float, float]]) -> str:
    return f"{max(m for m, _ in errors) * 1000:.1f} mm, {max(deg for _, deg in errors):.2f} degrees"
