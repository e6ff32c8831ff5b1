"""The shipped worlds are what their comments promise."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from functools import cache

import pytest

from eal_actors.device.world import BoxObstacle, CircleObstacle, WorldModel, load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager

STEP_M = 0.05
Cell = tuple[int, int]


@cache
def world(name: str) -> WorldModel:
    return load_world(bundled_path(f"fleets/worlds/{name}.yaml"))


def clearance_m(room: WorldModel, x_m: float, y_m: float) -> float:
    """Return how far a point is from the nearest wall or obstacle."""
    distances = [room.size_m[0] / 2 - abs(x_m), room.size_m[1] / 2 - abs(y_m)]
    distances += [_distance_m(obstacle, x_m, y_m) for obstacle in room.solid_obstacles]
    return min(distances)


def _distance_m(obstacle: BoxObstacle | CircleObstacle, x_m: float, y_m: float) -> float:
    turned = complex(x_m - obstacle.x_m, y_m - obstacle.y_m)
    if isinstance(obstacle, CircleObstacle):
        return abs(turned) - obstacle.radius_m
    turned *= complex(math.cos(math.radians(obstacle.yaw_deg)), -math.sin(math.radians(obstacle.yaw_deg)))
    beyond = (abs(turned.real) - obstacle.size_m[0] / 2, abs(turned.imag) - obstacle.size_m[1] / 2)
    return math.hypot(max(beyond[0], 0.0), max(beyond[1], 0.0))


def cell(x_m: float, y_m: float) -> Cell:
    return round(x_m / STEP_M), round(y_m / STEP_M)


def grid(room: WorldModel, radius_m: float) -> tuple[set[Cell], set[Cell]]:
    """Return where the middle of a robot may be, and where it may not; the room has an edge of one cell around it."""
    half_x, half_y = (round(size_m / 2 / STEP_M) + 1 for size_m in room.size_m)
    cells = {(x, y) for x in range(-half_x, half_x + 1) for y in range(-half_y, half_y + 1)}
    free = {(x, y) for x, y in cells if clearance_m(room, x * STEP_M, y * STEP_M) >= radius_m}
    return free, cells - free


def flood(start: Cell, cells: set[Cell], steps: Iterable[Cell]) -> dict[Cell, int]:
    """Return the cells that can be reached, and in how many steps."""
    reached, front = {start: 0}, deque([start])
    while front:
        x, y = front.popleft()
        for step_x, step_y in steps:
            there = (x + step_x, y + step_y)
            if there in cells and there not in reached:
                reached[there] = reached[(x, y)] + 1
                front.append(there)
    return reached


SIDES = ((1, 0), (-1, 0), (0, 1), (0, -1))
SIDES_AND_CORNERS = (*SIDES, (1, 1), (1, -1), (-1, 1), (-1, -1))


def test_the_maze_has_a_way_through_for_a_robot_of_two_decimetres() -> None:
    maze = world("maze")
    free, _ = grid(maze, 0.2)
    (goal,) = maze.beacons

    for start in maze.start_poses:
        reached = flood(cell(start.x_m, start.y_m), free, SIDES)
        steps = min(reached.get((x, y), 10**6) for x, y in free if math.dist((x, y), cell(goal.x_m, goal.y_m)) < 5)
        straight_m = math.dist((start.x_m, start.y_m), (goal.x_m, goal.y_m))
        assert 1.5 * straight_m < steps * STEP_M < 20


def test_the_maze_has_but_one_way() -> None:
    maze = world("maze")
    free, blocked = grid(maze, 0.2)
    start = maze.start_poses[0]

    assert set(flood(cell(start.x_m, start.y_m), free, SIDES)) == free, "no part of it is shut off"
    edge = min(blocked)
    assert set(flood(edge, blocked, SIDES_AND_CORNERS)) == blocked, "no wall stands alone, so no way leads round one"


def test_the_maze_has_blind_ends() -> None:
    maze = world("maze")
    cells = {(x, y) for x in range(5) for y in range(5)}

    def is_open(one: Cell, other: Cell) -> bool:
        x_m, y_m = ((one[axis] + other[axis]) / 2 - 2 for axis in range(2))
        return clearance_m(maze, x_m, y_m) > 0.2

    ways = {
        here: [there for dx, dy in SIDES if (there := (here[0] + dx, here[1] + dy)) in cells and is_open(here, there)]
        for here in cells
    }
    ends = {here for here, there in ways.items() if len(there) == 1} - {(0, 0), (4, 4)}
    assert len(ends) == 5
    assert sum(map(len, ways.values())) / 2 == len(cells) - 1, "a tree: one way between any two places"


def test_the_lab_leaves_room_in_the_middle() -> None:
    lab = world("lab")

    assert clearance_m(lab, 0.0, 0.0) >= 1.0
    for box in lab.boxes:
        assert clearance_m(lab, box.x_m, box.y_m) >= 0.4, "a robot gets round it"
    assert {poster.wall for poster in lab.posters} == {"north", "east", "south", "west"}


@pytest.mark.parametrize("name", ["maze", "field"])
def test_robots_fit_at_every_start(name: str) -> None:
    room = world(name)
    starts = [(pose.x_m, pose.y_m) for pose in room.start_poses]

    assert all(clearance_m(room, *start) > 0.25 for start in starts)
    assert all(math.dist(one, other) > 0.5 for one in starts for other in starts if one != other)


def test_the_field_has_a_place_for_each_robot_of_the_swarm() -> None:
    swarm = EALConfigManager.load(bundled_path("fleets/swarm.yaml"), environment={}).fleet

    assert swarm.world == world("field")
    assert len(swarm.robots) == len(world("field").start_poses) == 100
    assert swarm.rate == "max"
    assert all(dict(robot.plugins["sim"].settings) == {"model": "roomba"} for robot in swarm.robots.values())


def test_the_empty_room_is_empty() -> None:
    assert world("empty") == WorldModel(version=1, name="empty", size_m=(6.0, 4.0))
