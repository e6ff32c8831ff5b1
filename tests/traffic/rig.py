"""Fleets in lock step that travel: fixes with noise ten times a second, judged in each tick by the true hulls."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from random import Random
from typing import Any, Final

from eal_actors.actors.future import Future
from eal_actors.testing import Simulation

RADII_M: Final = {"evbot2": 0.18, "evbot3": 0.20, "roomba": 0.17}
TICK_S: Final = 0.05
FIX_TICKS: Final = 2
FIX_M: Final = 0.002
FIX_RAD: Final = math.radians(0.3)

Point = tuple[float, float]


class TravelWatch:
    """A simulated fleet whose robots know where they are, and its judge.

    Attributes:
        least_gap_m: the least distance between two hulls so far, by the true poses.
        trail: the true poses of all robots every half second, for pictures.
        untracked: robots that get no fixes.
    """

    def __init__(self, simulation: Simulation, radii_m: Mapping[str, float], seed: int) -> None:
        self.simulation = simulation
        self.radii_m = radii_m
        self.least_gap_m = math.inf
        self.trail: list[dict[str, tuple[float, float, float]]] = []
        self.untracked: set[str] = set()
        self._random = Random(seed)  # noqa: S311
        self._tick = 0
        self._poses: dict[str, tuple[float, float, float]] = {}
        self._pairs = list(itertools.combinations(radii_m, 2))

    def pose(self, name: str) -> tuple[float, float, float]:
        data = self.simulation[name]["TruePose"].glance()
        if data is not None:  # a dead robot answers nothing; it stands where it was
            x_m, y_m, yaw_rad = map(float, data.value)
            self._poses[name] = x_m, y_m, yaw_rad
        return self._poses[name]

    def tick(self) -> None:
        """Advance by a tick, and measure."""
        poses = {name: self.pose(name) for name in self.radii_m}
        for a, b in self._pairs:
            apart_m = math.hypot(poses[a][0] - poses[b][0], poses[a][1] - poses[b][1])
            if apart_m < 1.0:
                self.least_gap_m = min(self.least_gap_m, apart_m - self.radii_m[a] - self.radii_m[b])
        if self._tick % FIX_TICKS == 0:
            gauss = self._random.gauss
            for name, (x_m, y_m, yaw_rad) in poses.items():
                yaw_deg = math.degrees(yaw_rad + gauss(0, FIX_RAD))
                if name not in self.untracked:
                    self.simulation[name].pose.set(x_m + gauss(0, FIX_M), y_m + gauss(0, FIX_M), yaw_deg)
        if self._tick % round(0.5 / TICK_S) == 0:
            self.trail.append(poses)
        self._tick += 1
        self.simulation.advance(TICK_S)

    def until(self, is_over: Callable[[], bool], most_s: float = 600.0) -> None:
        end_s = self.simulation.now_s + most_s
        while not is_over():
            where = ", ".join(f"{name} {self.pose(name)}" for name in self.radii_m)
            assert self.simulation.now_s < end_s, f"not over after {most_s} s: {where}"
            for _ in range(2):
                self.tick()

    def until_done(self, future: Future[Any], most_s: float = 600.0) -> BaseException | None:
        self.until(future.done, most_s)
        return future.exception()

    def distance_m(self, name: str, goal: Point) -> float:
        return math.dist(self.pose(name)[:2], goal)


@contextmanager
def travelling(starts: Mapping[str, tuple[str, Point]], world: Mapping[str, Any], seed: int) -> Iterator[TravelWatch]:
    """Open a simulation; `starts` has each robot's model and place."""
    robots = {name: {"model": model, "start": (*at, 90.0)} for name, (model, at) in starts.items()}
    with Simulation(robots, world, seed=seed) as simulation:
        yield TravelWatch(simulation, {name: RADII_M[model] for name, (model, _) in starts.items()}, seed)


def floor(width_m: float, depth_m: float, *obstacles: Mapping[str, Any], **more: Any) -> dict[str, Any]:
    return {"version": 1, "name": "floor", "size_m": [width_m, depth_m], "obstacles": list(obstacles), **more}


def swap(count: int, seed: int) -> tuple[dict[str, tuple[str, Point]], dict[str, Point], dict[str, Any]]:
    """Return the starts and goals of two groups of robots that swap places in 6 x 6 m, and a world with pillars."""
    chance, half = Random(seed), count // 2  # noqa: S311
    starts: dict[str, tuple[str, Point]] = {}
    for number in range(count):
        column, row = divmod(number % half, 5)
        side = -1 if number < half else 1
        starts[f"r{number:02}"] = (list(RADII_M)[number % 3], (side * (2.45 - 0.8 * column), row - 2.0))
    names = list(starts)
    others = [*names[half:], *names[:half]]
    chance.shuffle(others)
    goals = {name: starts[other][1] for name, other in zip(names, others, strict=True)}
    pillars: list[Point] = []
    while len(pillars) < 4:
        at = chance.uniform(-0.9, 0.9), chance.uniform(-2.3, 2.3)
        if all(math.dist(at, other) > 0.8 for other in pillars):
            pillars.append(at)
    obstacles = [{"kind": "circle", "x_m": x_m, "y_m": y_m, "radius_m": 0.15} for x_m, y_m in pillars]
    return starts, goals, floor(6, 6, *obstacles)


class Mishaps:
    """Random stops and weak motors, and one robot that is killed on its way.

    Attributes:
        killed: the name of the robot that was killed; None until then.
    """

    def __init__(self, watch: TravelWatch, seed: int) -> None:
        self._watch = watch
        self._random = Random(seed)  # noqa: S311
        self._stopped_until_s: dict[str, float] = {}
        self._shares: dict[str, float] = {}
        self.killed: str | None = None
        for name in self._random.sample(sorted(watch.radii_m), max(1, len(watch.radii_m) // 4)):
            share = self._random.uniform(0.5, 0.9)
            self._shares[name] = share
            watch.simulation.inject(name, motor_left=share, motor_right=share)

    def happen(self) -> None:
        """Let happen what is due; to be called every 0.1 s."""
        now_s, simulation = self._watch.simulation.now_s, self._watch.simulation
        for name, until_s in list(self._stopped_until_s.items()):
            if now_s >= until_s:
                del self._stopped_until_s[name]
                share = self._shares.get(name, 1.0)
                simulation.inject(name, motor_left=share, motor_right=share)
        for name in self._watch.radii_m:
            if name not in self._stopped_until_s and name != self.killed and self._random.random() < 0.004:
                self._stopped_until_s[name] = now_s + self._random.uniform(0.5, 7.0)
                simulation.inject(name, motor_left=0.0, motor_right=0.0)  # no stuck wheel, which ends a motion
        if self.killed is None and now_s > 8.0:
            middle = [name for name in self._watch.radii_m if abs(self._watch.pose(name)[0]) < 1.2]
            if middle:
                self.killed = self._random.choice(middle)
                simulation.inject(self.killed, dead=True)
