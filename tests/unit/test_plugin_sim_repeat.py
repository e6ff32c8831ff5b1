"""plugins/sim repeats itself: a robot's path depends on seed, name and motions, bit by bit, and on nothing else."""

import random
from collections.abc import Callable, Generator
from itertools import repeat
from typing import Any

import pytest

from eal_actors.clock import ManualClock
from eal_actors.plugin import WorldModel
from plugins.sim.models import MAKES, MakeName
from plugins.sim.resources import Base
from plugins.sim.world import SimWorld

Pose = tuple[str, str, str]
Waits = Callable[[], float]

ROOM = WorldModel.model_validate(
    {
        "version": 1,
        "name": "room",
        "size_m": (6.0, 4.0),
        "obstacles": (
            {"kind": "box", "x_m": 0.4, "y_m": 1.7, "width_m": 1.0, "height_m": 0.3, "yaw_deg": 10.0},
            {"kind": "circle", "x_m": 1.2, "y_m": 1.4, "radius_m": 0.2},
        ),
    }
)
SQUARE = ["g", "r", "g", "r", "g", "r", "g", "r", "s", "l", "b", "l", "b", "l", "b", "l", "b", "s"]
INTO_THINGS = ["l75", "f3", "r30", "f2", "r60", "f1.5", "b0.3", "l200", "f4", "r90", "f4"]  # corners and niches too


class RecordedWorld(SimWorld):
    """A SimWorld that keeps each driven robot's pose of every tick, as exact text."""

    def __init__(self, clock: ManualClock, seed: int) -> None:
        super().__init__(clock, seed, ROOM)
        self.paths: dict[str, list[Pose]] = {}

    def _run_tick(self) -> None:
        driven = list(self._driven)
        super()._run_tick()
        for robot in driven:
            x_m, y_m, yaw_rad = robot.pose
            self.paths.setdefault(robot.name, []).append((x_m.hex(), y_m.hex(), yaw_rad.hex()))


def commands_of(base: Base, texts: list[str], gaps: Waits) -> Generator[float, None, None]:
    """Carry out commands one after the other, with a pause before each."""
    for text in texts:
        yield gaps()
        activity = base.send_cmd(text)
        if not isinstance(activity, int):
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
    """
    clock = ManualClock()
    world = RecordedWorld(clock, seed)
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
        with world.caught_up():
            pass
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
@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
@pytest.mark.parametrize("noise", [True, False], ids=["noise", "exact"])
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


@pytest.mark.parametrize("model", MAKES)
def test_noise_is_about_one_percent_of_a_distance_and_two_of_an_angle(model: MakeName) -> None:
    ends = [path_of(["f2"], model=model, seed=seed)[-1] for seed in range(20)]
    distances_m = [float.fromhex(x_m) for x_m, _, _ in ends]
    assert all(abs(distance_m / 2 - 1) < 0.03 for distance_m in distances_m)
    turns_rad = [float.fromhex(path_of(["l90"], model=model, seed=seed)[-1][2]) for seed in range(20)]
    assert all(0.0001 < abs(turn_rad / 1.5707963 - 1) < 0.04 for turn_rad in turns_rad)


def test_an_idle_world_skips_its_ticks() -> None:
    clock = ManualClock()
    world = RecordedWorld(clock, 1)
    for index in range(3):
        world.join(f"r{index}", MAKES["roomba"], noise=True, start=None)
    clock.advance(1e9)  # would take days
    with world.caught_up() as now_s:
        assert now_s == pytest.approx(1e9)
    assert world.paths == {}
