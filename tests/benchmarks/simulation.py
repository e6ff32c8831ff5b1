"""Simulated robots at `rate: max`, on one core: how much faster than real time a fleet runs through all its actors."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pymunk

from eal_actors import Fleet
from eal_actors.scenario import load_scenario, run_scenario
from eal_actors.testing import Simulation
from plugins.sim.models import MAKES
from tests.benchmarks.result import Result

ROOT = Path(__file__).parents[2]
RAYS, RAY_M, RAYS_HZ = 16, 4.0, 10
TICK_S = 0.02
SPACING_M = 1.5
SPEED_M_S = 0.3
TURNS = 3


def fleet_file(folder: Path, robots: int) -> Path:
    """Write a fleet of Roombas in a grid on a field; return the file."""
    side_m = SPACING_M * (math.ceil(math.sqrt(robots)) + 1)
    world = f"version: 1\nname: field\nsize_m: [{side_m}, {side_m}]\n"
    world += f"starts: {{shape: grid, count: {robots}, spacing_m: {SPACING_M}}}\n"
    (folder / "field.yaml").write_text(world)
    fleet = folder / "fleet.yaml"
    each = f"{{count: {robots}, plugins: {{sim: {{model: roomba}}}}}}"
    fleet.write_text(f'version: 1\nclock: {{rate: max}}\nworld: field.yaml\nrobots: {{"robot{{n}}": {each}}}\n')
    return fleet


@contextmanager
def one_core() -> Iterator[None]:
    """Pin this process and its threads to one core."""
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)


def times_real(fleet: Fleet, duration_s: float, work: Callable[[], object], period_s: float) -> float:
    """Return how many seconds of the fleet's clock pass in a real one while work is done in each period."""
    start_s, start = fleet.clock.now(), time.perf_counter()
    while fleet.clock.now() - start_s < duration_s:
        work()
        fleet.clock.sleep(period_s)
    return (fleet.clock.now() - start_s) / (time.perf_counter() - start)


def bare_times_real(robots: int, duration_s: float, *, rays: bool) -> float:
    """Return the same of bare pymunk: as many discs that drive, the same rays, nothing else."""
    space, bodies = pymunk.Space(), []
    for number in range(robots):
        body = pymunk.Body(3.0, 0.05)
        column, row = divmod(number, math.ceil(math.sqrt(robots)))
        body.position = column * SPACING_M, row * SPACING_M
        disc = pymunk.Circle(body, 0.17)
        disc.filter = pymunk.ShapeFilter(group=number + 1)
        control = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        control.position = body.position
        pivot, gear = pymunk.PivotJoint(control, body, (0, 0), (0, 0)), pymunk.GearJoint(control, body, 0.0, 1.0)
        pivot.max_bias = gear.max_bias = 0.0
        pivot.max_force = gear.max_force = 20.0
        space.add(body, disc, control, pivot, gear)
        bodies.append((body, disc.filter, control))
    angles = [2 * math.pi * ray / RAYS for ray in range(RAYS)]
    every = round(1 / (RAYS_HZ * TICK_S))
    start = time.perf_counter()
    for tick in range(round(duration_s / TICK_S)):
        for body, _, control in bodies:
            control.velocity = SPEED_M_S * math.cos(body.angle), SPEED_M_S * math.sin(body.angle)
            control.angular_velocity = 0.5
        space.step(TICK_S)
        if rays and tick % every == 0:
            for body, own, _ in bodies:
                x, y = body.position
                for angle in angles:
                    end = x + RAY_M * math.cos(angle), y + RAY_M * math.sin(angle)
                    space.segment_query_first((x, y), end, 0.0, own)
    return duration_s / (time.perf_counter() - start)


def crowd(folder: Path, robots: int, duration_s: float, *, rays: bool, at_least: float) -> Result:
    """Drive a fleet, with or without looking round; a look at one pose has the physics of all keep up.

    The fastest of three turns counts, for ours and for the bare engine: it is what a busy machine disturbs least.
    """
    with Fleet.load(fleet_file(folder, robots)) as fleet:
        looked, sensor = (list(fleet), "Range") if rays else (list(fleet)[:1], "TruePose")
        driving = fleet.send(fleet, "Base", "f50", timeout_s=2000)

        def look() -> None:
            fleet.read(looked, sensor).get()

        times_real(fleet, 1.0, look, 1 / RAYS_HZ)  # warm up
        ours = max(times_real(fleet, duration_s, look, 1 / RAYS_HZ) for _ in range(TURNS))
        if driving.done():
            raise AssertionError("the robots do not drive any more")
        fleet.halt().get()
        driving.exception()
    bare = max(bare_times_real(robots, duration_s, rays=rays) for _ in range(TURNS))
    what = f"{robots:,} simulated robots driving, " + (f"{RAYS} rays each at {RAYS_HZ} Hz" if rays else "no rays")
    reference = f"bare pymunk: {bare:.1f}x real time"
    return Result(what, f"{ours:.1f}x real time", reference, ours / bare, at_least, "x bare pymunk", at_least=True)


def square(folder: Path) -> Result:
    """One robot drives the shipped square."""
    scenario = load_scenario(ROOT / "scenarios/square.yaml")
    with Fleet.load(fleet_file(folder, 1)) as fleet:
        turns = []
        for _ in range(5):
            start = time.perf_counter()
            report = run_scenario(scenario, fleet)
            turns.append(report.duration_s / (time.perf_counter() - start))
            if report.outcome != "done":
                raise AssertionError(report.error)
    ours = sorted(turns)[len(turns) // 2]
    what = "the square scenario, one robot, lock step"
    return Result(what, f"{ours:.0f}x real time", "real time", ours, 200, "x real time", at_least=True)


def sink() -> Result:
    """Each make drives at a wall at full speed, straight and aslant, and goes on pushing."""
    deepest_mm, radii_m = 0.0, {make.name: make.radius_m for make in MAKES.values()}
    for model, radius_m in radii_m.items():
        for yaw_deg in (0, 30, 60):
            with Simulation({"it": {"model": model, "start": (2.2, 0.0, yaw_deg)}}, "empty") as simulation:
                base = simulation["it"]["Base"]
                base.set_config("speed_m_s", base.info.config("speed_m_s").value.maximum).get()
                drive = base.send_cmd("f2")
                while not drive.done():
                    simulation.advance(TICK_S)
                    pose = simulation.pose("it")
                    deepest_mm = max(deepest_mm, 1e3 * (max(pose.x_m - 3.0, abs(pose.y_m) - 2.0) + radius_m))
    what = "a robot pushing a wall sinks in, each make, three angles"
    return Result(what, f"{deepest_mm:.2f} mm", "", deepest_mm, 2, "mm")


def run() -> list[Result]:
    """Measure once each: a run of seconds is its own mean."""
    with tempfile.TemporaryDirectory() as name, one_core():
        folder = Path(name)
        return [
            square(folder),
            sink(),
            crowd(folder, 100, 5.0, rays=True, at_least=1.2),
            crowd(folder, 1000, 2.0, rays=False, at_least=2),
        ]
