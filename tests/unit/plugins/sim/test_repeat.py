"""plugins/sim repeats itself: a robot's path depends on seed, name and motions, bit by bit, and on nothing else."""

import math
import os
import random
import subprocess
import sys
from collections.abc import Callable, Generator
from contextlib import suppress
from itertools import repeat
from pathlib import Path
from typing import Any

import pytest

from eal_actors.device.localization.localizer import Localizer
from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import BlockedError
from plugins.sim.models import MAKES, MakeName
from plugins.sim.resources import Base
from plugins.sim.resources.pose import Pose as SimPose
from plugins.sim.robot import SimRobot
from plugins.sim.world import SimWorld
from tests.manual_clock import ManualClock

Pose = tuple[str, str, str]
Waits = Callable[[], float]

ROOM = WorldModel.model_validate(
    {
        "version": 1,
        "name": "room",
        "size_m": (6.0, 4.0),
        "obstacles": (
            {"kind": "box", "x_m": 0.4, "y_m": 1.7, "size_m": (1.0, 0.3), "yaw_deg": 10.0},
            {"kind": "circle", "x_m": 1.2, "y_m": 1.4, "radius_m": 0.2},
        ),
    }
)
BOXES = ROOM.model_validate(
    {
        **ROOM.model_dump(),
        "boxes": ({"name": "a", "x_m": 0.25, "y_m": 0.7, "yaw_deg": 30.0}, {"name": "b", "x_m": -1.0, "y_m": 0.5}),
    }
)
ROOT = Path(__file__).parents[4]
SQUARE = ["g", "r", "g", "r", "g", "r", "g", "r", "s", "l", "b", "l", "b", "l", "b", "l", "b", "s"]
INTO_THINGS = ["l75", "f3", "r30", "f2", "r60", "f1.5", "b0.3", "l200", "f4", "r90", "f4"]  # corners and niches too


class RecordedWorld(SimWorld):
    """A SimWorld that keeps each driven robot's pose of every tick, as exact text."""

    def __init__(self, clock: ManualClock, seed: int, model: WorldModel = ROOM) -> None:
        super().__init__(clock, seed, model)
        self.paths: dict[str, list[Pose]] = {}

    def join(self, name: str, *args: Any, **settings: Any) -> SimRobot:
        robot = super().join(name, *args, **settings)
        arrive = robot.arrive

        def arrive_and_tell(pose: tuple[float, float, float]) -> None:
            arrive(pose)
            x_m, y_m, yaw_rad = robot.pose
            self.paths.setdefault(name, []).append((x_m.hex(), y_m.hex(), yaw_rad.hex()))

        robot.arrive = arrive_and_tell  # type: ignore[method-assign]  # at every tick of a motion
        return robot


def commands_of(base: Base, texts: list[str], gaps: Waits) -> Generator[float, None, None]:
    """Carry out commands one after the other, with a pause before each."""
    for text in texts:
        yield gaps()
        activity = base.send_cmd(text)
        if not isinstance(activity, int):
            with suppress(BlockedError):
                assert (yield from activity) == 1


def path_of(
    texts: list[str],
    *,
    model: MakeName = "evbot2",
    noise: bool = True,
    seed: int = 7,
    name: str = "r1",
    gaps: Waits = lambda: 0.0,
    polls: Waits | None = None,
    others: bool = False,
    room: WorldModel = ROOM,
) -> list[Pose]:
    """Return the path of a robot in the middle of the room.

    Args:
        texts: its commands.
        model: its make.
        noise: whether its wheels have errors.
        seed: the fleet's seed.
        name: its name.
        gaps: pauses before the commands, in seconds.
        polls: somebody looks at the world at these intervals, in seconds; None for nobody.
        others: two more robots move elsewhere, without pause.
        room: the world they are in.
    """
    clock = ManualClock()
    world = RecordedWorld(clock, seed, room)
    robot = world.join(name, MAKES[model], noise=noise, start=(0.0, 0.0, 0.0))
    running: dict[Any, float] = {commands_of(Base(world, robot), texts, gaps): 0.0}
    (leader,) = running
    if others:
        for x_m, other in ((-2.5, "a"), (2.6, "z")):
            moved = Base(world, world.join(other, MAKES["roomba"], noise=True, start=(x_m, -1.6, 0.0)))
            running[commands_of(moved, ["l45", "r50", "f0.03", "b0.03", "r31"] * 99, lambda: 0.0)] = 0.0
    if polls:
        running[iter(polls, None)] = 0.0
    while leader in running:
        task = min(running, key=lambda task: running[task])
        clock.advance(max(0.0, running[task] - clock.now()))
        with world.lock:
            world.catch_up()
            robot.space.point_query_nearest((0.0, 0.0), 1.0, robot.filter)  # reading changes nothing
        wait_s = next(task, None)
        if wait_s is None:
            del running[task]
        else:
            running[task] = clock.now() + wait_s
    return world.paths[name]


def random_waits(most_s: float) -> Waits:
    source = random.Random(3)  # noqa: S311
    return lambda: source.uniform(0.0, most_s)


@pytest.mark.parametrize("texts", [SQUARE, INTO_THINGS], ids=["square", "into things"])
@pytest.mark.parametrize(
    ("model", "noise"),
    [
        pytest.param("evbot2", True, marks=pytest.mark.slow),
        ("evbot3", False),
        pytest.param("roomba", True, marks=pytest.mark.slow),
    ],
)
def test_the_path_is_the_same_bit_by_bit(texts: list[str], model: MakeName, noise: bool) -> None:
    path = path_of(texts, model=model, noise=noise)
    assert len(path) > 500
    for name, variant in {
        "once more": path_of(texts, model=model, noise=noise),
        "idle gaps": path_of(texts, model=model, noise=noise, gaps=random_waits(3.0)),
        "polled every 3 ms": path_of(texts, model=model, noise=noise, polls=repeat(0.003).__next__),
        "polled at any time": path_of(texts, model=model, noise=noise, polls=random_waits(2.0)),
        "others move": path_of(texts, model=model, noise=noise, others=True),
        "all of it": path_of(
            texts, model=model, noise=noise, gaps=random_waits(1.7), polls=random_waits(0.1), others=True
        ),
    }.items():
        assert variant == path, name


def test_other_seeds_and_other_names_take_other_paths() -> None:
    paths = [path_of(SQUARE), path_of(SQUARE, seed=8), path_of(SQUARE, name="r2")]
    assert len({path[-1] for path in paths}) == 3
    assert path_of(SQUARE, noise=False) == path_of(SQUARE, noise=False, seed=8)


def test_an_idle_world_skips_its_ticks() -> None:
    clock = ManualClock()
    world = RecordedWorld(clock, 1)
    for index in range(3):
        world.join(f"r{index}", MAKES["roomba"], noise=True, start=None)
    clock.advance(1e9)  # would take days
    with world.lock:
        now_s = world.catch_up()
        assert now_s == pytest.approx(1e9)
    assert world.paths == {}


DIGEST = """
import hashlib
from tests.unit.plugins.sim.test_repeat import BOXES, INTO_THINGS, SQUARE, path_of
paths = [path_of(texts, model=model) for texts in (SQUARE, INTO_THINGS) for model in ("evbot2", "roomba")]
paths.append(path_of(INTO_THINGS, model="evbot3", others=True, room=BOXES))
print(hashlib.sha256(repr(paths).encode()).hexdigest())
"""


@pytest.mark.slow
def test_another_process_takes_the_same_path_bit_by_bit() -> None:
    def digest(hash_seed: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONHASHSEED": hash_seed}
        run = subprocess.run(
            [sys.executable, "-c", DIGEST], cwd=ROOT, env=environment, check=True, capture_output=True, text=True
        )
        return run.stdout

    assert digest("1") == digest("2") != ""


def test_a_robot_that_pushes_boxes_takes_the_same_path_bit_by_bit() -> None:
    path = path_of(INTO_THINGS, room=BOXES)
    assert path != path_of(INTO_THINGS)
    assert path_of(INTO_THINGS, room=BOXES, polls=random_waits(0.1), gaps=random_waits(0.0)) == path


def pose_after(texts: list[str], polls: Waits | None) -> list[float]:
    """Return the estimate after commands, in which somebody reads the estimate at intervals; None for nobody."""
    clock = ManualClock()
    world = SimWorld(clock, 7, ROOM)
    robot = world.join("r1", MAKES["roomba"], noise=True, start=(0.0, 0.0, 0.0))
    pose = SimPose(world, robot, Localizer("r1"), clock, is_calibrated=False)
    due_s = math.inf if polls is None else 0.0
    for wait_s in commands_of(Base(world, robot), texts, lambda: 0.0):
        end_s = clock.now() + wait_s
        while due_s < end_s and polls is not None:
            clock.advance(max(0.0, due_s - clock.now()))
            pose.get_value()
            due_s += polls()
        clock.advance(end_s - clock.now())
    return [float(number) for number in pose.get_value().value]


def test_readings_leave_no_trace_in_later_estimates() -> None:
    texts = ["f0.4", "l75", "f0.3", "r30", "b0.4", "r90", "f0.5", "l60", "b0.3"]
    quiet = pose_after(texts, None)
    assert pose_after(texts, repeat(0.1).__next__) == quiet
    assert pose_after(texts, random_waits(0.05)) == quiet
