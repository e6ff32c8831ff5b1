"""Frames of the simulated camera, 640 x 480, in the laboratory with four robots in view, on one core."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from eal_actors.device.world import load_world
from plugins.sim.camera.eye import Eye
from plugins.sim.camera.movers import BoxAt, Mover, RobotAppearance, RobotAt
from plugins.sim.camera.render import render
from plugins.sim.camera.scene import Scene
from plugins.sim.models import MAKES, MakeName
from tests.benchmarks.result import Result
from tests.benchmarks.simulation import one_core

LAB = Path(__file__).parents[2] / "fleets" / "worlds" / "lab.yaml"
TURNS, FRAMES = 10, 15
_DRAWS = ("warpPerspective", "remap", "blendLinear", "multiply", "convertScaleAbs", "cvtColor")
"""The functions of OpenCV that draw."""
ROBOTS: tuple[tuple[MakeName, float, float, float], ...] = (
    ("roomba", 0.6, 0.2, 200),
    ("evbot3", 1.4, -0.4, 150),
    ("evbot2", 0.9, 1.1, -100),
    ("roomba", 2.4, 0.4, 30),
)
EYES = ((-1.5, 0.0, 0.22, 5), (-0.2, 0.3, 0.22, 0), (-2.6, 0.3, 0.4, 3))


def robot(name: MakeName, x_m: float, y_m: float, yaw_deg: float) -> RobotAt:
    """Return a robot of a make, in view."""
    make = MAKES[name]
    look = RobotAppearance(make.radius_m, make.height_m, make.body_colour, make.camera_height_m)
    return RobotAt(look, x_m, y_m, math.radians(yaw_deg))


def duration_s(action: Callable[[], object]) -> float:
    """Return how long an action takes, the mean of some."""
    start = time.perf_counter()
    for _ in range(FRAMES):
        action()
    return (time.perf_counter() - start) / FRAMES


def library_calls(action: Callable[[], object]) -> Callable[[], None]:
    """Return a function that repeats the calls of OpenCV that an action makes, and nothing else: the action's floor."""
    calls: list[partial[object]] = []

    def recorded(function: Callable[..., object]) -> Callable[..., object]:
        def call(*arguments: object, **options: object) -> object:
            calls.append(partial(function, *arguments, **options))
            return function(*arguments, **options)

        return call

    with ExitStack() as stack:
        for name in _DRAWS:
            stack.callback(setattr, cv2, name, getattr(cv2, name))
            setattr(cv2, name, recorded(getattr(cv2, name)))
        action()

    def repeat() -> None:
        for call in calls:
            call()

    return repeat


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV to one thread on one core."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with one_core():
            yield
    finally:
        cv2.setNumThreads(threads)


def run() -> list[Result]:
    """Measure in ten turns with a bare warp; the fastest turn counts, for what disturbs only makes it slower."""
    model = load_world(LAB)
    scene = Scene(model)
    movers: list[Mover] = [robot(*place) for place in ROBOTS]
    movers += [BoxAt(number, box.x_m, box.y_m, math.radians(box.yaw_deg)) for number, box in enumerate(model.boxes)]
    eyes = [Eye(x_m, y_m, z_m, math.radians(yaw_deg)) for x_m, y_m, z_m, yaw_deg in EYES]
    picture = render(scene, movers, eyes[0])
    tilted = np.array([[1.0, 0.1, 20.0], [0.05, 0.9, 10.0], [1e-4, 0.0, 1.0]])

    def look_round() -> None:
        for eye in eyes:
            render(scene, movers, eye)

    with one_thread():
        look_round()
        library = library_calls(look_round)
        turns = [
            (
                duration_s(look_round) / len(eyes),
                duration_s(library) / len(eyes),
                duration_s(lambda: cv2.warpPerspective(picture, tilted, (640, 480))),
            )
            for _ in range(TURNS)
        ]
    ours, least, bare = (min(column) for column in zip(*turns, strict=True))
    what = "camera 640 x 480 in lab.yaml, 4 robots in view, one core"
    reference = (
        f"one warpPerspective of the frame: {bare * 1e3:.1f} ms; the frame's calls of OpenCV alone: {least / bare:.1f}x"
    )
    return [Result(what, f"{ours * 1e3:.1f} ms a frame", reference, ours / bare, 3.0)]
