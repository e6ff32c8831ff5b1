"""Range rays: closed forms, pymunk's own answers, and who is cast together."""

from __future__ import annotations

import gc
import math
import weakref
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import PluginError, UnavailableError
from eal_actors.plugin import EALData
from plugins.sim.models import MAKES
from plugins.sim.resources import Base, Range
from plugins.sim.robot import SimRobot
from plugins.sim.sensors import MAX_RANGE_M, RAY_ANGLES_RAD, RAYS
from plugins.sim.sensors.arrays import shared
from plugins.sim.sensors.rays import RayCaster
from tests.unit.plugins.sim.sensing import Stage, room


def read(stage: Stage, robot: SimRobot) -> NDArray[np.float64]:
    with stage.world.lock:
        now_s = stage.world.catch_up()
        return shared(stage.world, RayCaster).ranges_m(stage.world, robot, now_s)


def by_pymunk(robot: SimRobot) -> list[float]:
    """Return what the physics engine says that each ray meets."""
    x_m, y_m, yaw_rad = robot.pose
    found_m = []
    for angle_rad in (RAY_ANGLES_RAD + yaw_rad).tolist():
        end = x_m + MAX_RANGE_M * math.cos(angle_rad), y_m + MAX_RANGE_M * math.sin(angle_rad)
        hit = robot.space.segment_query_first((x_m, y_m), end, 0.0, robot.filter)
        found_m.append(hit.alpha * MAX_RANGE_M if hit else MAX_RANGE_M)
    return found_m


def random_model(generator: np.random.Generator) -> WorldModel:
    def place(**fields: Any) -> dict[str, Any]:
        x_m, y_m = generator.uniform((-4, -3), (4, 3)).tolist()
        return {"x_m": x_m, "y_m": y_m, **fields}

    def size() -> tuple[float, ...]:
        return tuple(generator.uniform(0.05, 1.2, 2).tolist())

    def yaw_deg() -> float:
        return float(generator.uniform(-360, 360))

    walls = [generator.uniform((-4, -3), (4, 3), (2, 2)).tolist() for _ in range(2)]
    return room(
        8.0,
        6.0,
        obstacles=(
            *(place(kind="box", size_m=size(), yaw_deg=yaw_deg()) for _ in range(5)),
            *(place(kind="circle", radius_m=float(generator.uniform(0.02, 0.5))) for _ in range(4)),
            *({"kind": "wall", "start_m": tuple(start), "end_m": tuple(end)} for start, end in walls),
        ),
        boxes=tuple(place(name=f"box{n}", size_m=size(), yaw_deg=yaw_deg()) for n in range(3)),
        beacons=tuple(place(name=f"beacon{n}") for n in range(3)),
    )


@pytest.mark.parametrize("seed", range(25))
def test_rays_agree_with_the_physics_engine(seed: int) -> None:
    generator = np.random.default_rng(seed)
    stage = Stage(random_model(generator))
    robots: list[SimRobot] = []
    for x_m, y_m, yaw_rad in generator.uniform((-3.8, -2.8, -20), (3.8, 2.8, 20), (80, 3)).tolist():
        try:
            robots.append(stage.put(x_m, y_m, yaw_rad, list(MAKES)[len(robots) % len(MAKES)]))
        except PluginError:
            continue  # the place is taken
    assert len(robots) > 10
    for robot in robots:
        np.testing.assert_allclose(read(stage, robot), by_pymunk(robot), atol=0.001)


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, -101.25, 725.0])
def test_rays_reach_the_walls_of_a_square_room(yaw_deg: float) -> None:
    stage, x_m, y_m = Stage(room(4.0, 4.0)), 0.5, -0.25
    robot = stage.put(x_m, y_m, math.radians(yaw_deg))
    for ray, found_m in enumerate(read(stage, robot).tolist()):
        angle_rad = math.radians(yaw_deg + 22.5 * ray)
        end_x_m, end_y_m = x_m + found_m * math.cos(angle_rad), y_m + found_m * math.sin(angle_rad)
        assert max(abs(end_x_m), abs(end_y_m)) == pytest.approx(2.0, abs=1e-9)


def test_ranges_fit_the_geometry() -> None:
    box = {"kind": "box", "x_m": 0.0, "y_m": 1.5, "size_m": (2.0, 0.2)}
    turned = {"kind": "box", "x_m": -1.5, "y_m": 0.0, "size_m": (0.2, 1.0), "yaw_deg": 45.0}
    pillar = {"kind": "circle", "x_m": 0.0, "y_m": -1.0, "radius_m": 0.25}
    stage = Stage(room(10, 8, obstacles=(box, turned, pillar)))
    robot = stage.put(0, 0, 0)
    stage.put(3.0, 0)
    ranges = read(stage, robot)
    assert ranges[0] == pytest.approx(3.0 - 0.17)  # the other robot
    assert ranges[1] == 4.0  # the wall at 5 / cos(22.5 deg) is too far
    assert ranges[4] == pytest.approx(1.4)  # the box, on the left
    assert ranges[3] == pytest.approx(1.4 / math.cos(math.pi / 8))
    assert ranges[8] == pytest.approx(1.5 - 0.1 * math.sqrt(2))  # the turned box, behind
    assert ranges[12] == pytest.approx(0.75)  # the pillar, on the right


def test_the_nearest_of_several_hides_the_others() -> None:
    pillars = tuple({"kind": "circle", "x_m": x_m, "y_m": 0.0, "radius_m": 0.1} for x_m in (1.5, 1.0, 2.0))
    stage = Stage(room(obstacles=pillars))
    assert read(stage, stage.put(0, 0))[0] == pytest.approx(0.9)


def test_a_beacon_and_a_box_are_in_the_way() -> None:
    beacon = {"name": "post", "x_m": 1.0, "y_m": 0.0, "radius_m": 0.05}
    box = {"name": "crate", "x_m": 0.0, "y_m": 1.0, "size_m": (0.3, 0.4)}
    stage = Stage(room(beacons=(beacon,), boxes=(box,)))
    ranges = read(stage, stage.put(0, 0))
    assert (ranges[0], ranges[4]) == pytest.approx((0.95, 0.8))


def test_a_box_is_seen_where_it_was_pushed_to() -> None:
    box = {"name": "crate", "x_m": 0.5, "y_m": 0.0, "size_m": (0.2, 0.2)}
    stage = Stage(room(boxes=(box,)))
    robot = stage.put(0, 0)
    before_m = read(stage, robot)[0]
    motion = Base(stage.world, robot).send_cmd("f1")
    next(motion)
    stage.clock.advance(3.0)
    assert before_m == pytest.approx(0.4)
    np.testing.assert_allclose(read(stage, robot), by_pymunk(robot), atol=1e-9)
    assert stage.world.boxes[0].pose[0] > 0.7
    motion.close()


def test_a_robot_that_joins_is_seen_at_once() -> None:
    stage = Stage()
    first = stage.put(0, 0)
    assert read(stage, first)[0] == pytest.approx(3.0)
    second = stage.put(1.0, 0)
    assert read(stage, first)[0] == pytest.approx(0.83)
    assert read(stage, second)[8] == pytest.approx(0.83)


def test_a_robot_without_a_place_has_no_rays() -> None:
    stage = Stage(room(1.0, 1.0))
    stage.put(0, 0)
    homeless = stage.world.join("late", MAKES["roomba"], noise=False, start=None)
    with pytest.raises(UnavailableError, match="no free place for robot 'late'"):
        read(stage, homeless)


@pytest.mark.parametrize("readers", [(0,), (0, 1, 2, 3, 4), (4, 2), (0, 0, 3)])
def test_who_else_reads_changes_nothing(readers: tuple[int, ...]) -> None:
    """Robots drive and read at a steady rate, so that they are foreseen; another fleet reads only once, at the end."""

    def drive(readers: tuple[int, ...]) -> list[list[float]]:
        stage = Stage()
        robots = [stage.put(x_m, x_m / 3, x_m) for x_m in (-2.0, -1.0, 0.0, 1.0, 2.0)]
        motions = [Base(stage.world, robot).send_cmd("f1") for robot in robots]
        for motion in motions:
            next(motion)
        for _ in range(8):
            stage.clock.advance(0.1)
            for reader in readers:
                read(stage, robots[reader])
        for motion in motions:
            motion.close()
        return [read(stage, robot).tolist() for robot in robots]

    assert drive(readers) == drive(())


def test_what_was_foreseen_is_what_the_world_is_then() -> None:
    stage = Stage(room(12, 12))
    robots = [stage.put(x_m, y_m, x_m - y_m) for x_m in (-4, -2, 0, 2, 4) for y_m in (-4, -2, 0, 2, 4)]
    motions = [Base(stage.world, robot).send_cmd("f1") for robot in robots]
    for motion in motions:
        next(motion)
    for beat in range(12):
        stage.clock.advance(0.1 if beat < 6 else 0.14)
        for robot in robots[:: 1 + beat % 2]:
            np.testing.assert_allclose(read(stage, robot), by_pymunk(robot), atol=1e-9)
    for motion in motions:
        motion.close()


def test_who_reads_at_a_steady_rate_is_cast_with_the_first_who_asks() -> None:
    stage = Stage()
    robots = [stage.put(x_m, 0, name=name) for name, x_m in (("a", -1), ("b", 0), ("c", 1))]
    driving = Base(stage.world, stage.put(-2, 1.5, name="driven")).send_cmd("f4")
    next(driving)

    def cast_for_a(readers: list[SimRobot]) -> set[str]:
        stage.clock.advance(0.1)
        read(stage, robots[0])
        cast = set(shared(stage.world, RayCaster)._found_m)
        for robot in readers:
            read(stage, robot)
        return cast

    assert cast_for_a(robots) == {"a"}
    assert cast_for_a(robots) == {"a"}
    assert cast_for_a(robots[:2]) == {"a", "b", "c"}  # c ceases to read
    assert cast_for_a(robots[:2]) == {"a", "b"}
    driving.close()
    assert cast_for_a(robots) == {"a", "b"}  # nothing has moved since, so nothing is cast


def test_the_sensors_do_not_keep_a_world_alive() -> None:
    stage = Stage(room(boxes=({"name": "crate", "x_m": 1.0, "y_m": 1.0},)))
    read(stage, stage.put(0, 0))
    world = weakref.ref(stage.world)
    del stage
    gc.collect()
    assert world() is None


# The resource.


def test_a_range_says_unit_frame_and_time() -> None:
    stage = Stage()
    sensor = Range(stage.world, stage.put(0, 0, name="r1"))
    stage.clock.advance(0.5)
    data = sensor.get_value()
    assert (data.value.shape, data.value.dtype, data.unit, data.frame_id) == ((16,), np.float64, "m", "r1/base")
    assert data.stamp_s == pytest.approx(0.5)
    angles = sensor.send_req("angles").value
    assert angles == pytest.approx([math.radians(22.5 * ray) for ray in range(16)])


def test_a_shorter_range_cuts_what_is_farther() -> None:
    stage = Stage(room(4.0, 2.0))
    sensor = Range(stage.world, stage.put(0, 0))
    full = sensor.get_value().value
    sensor.set_config("max_range_m", EALData.of(1.5))
    assert sensor.get_config("max_range_m") == 1.5
    np.testing.assert_array_equal(sensor.get_value().value, np.minimum(full, 1.5))
    sensor.set_config("noise_m", EALData.of(0.5))
    for _ in range(50):
        noisy = sensor.get_value().value
        assert noisy.min() >= 0
        assert noisy.max() <= 1.5
        assert (noisy[full >= 1.5] == 1.5).all()


def test_range_noise_has_the_mean_and_spread_that_was_set() -> None:
    stage = Stage(room(4.0, 4.0))
    sensor = Range(stage.world, stage.put(0, 0))
    clean = sensor.get_value().value
    sensor.set_config("noise_m", EALData.of(0.02))
    errors = np.array([sensor.get_value().value - clean for _ in range(500)])
    count = 500 * RAYS
    assert abs(errors.mean()) < 4 * 0.02 / math.sqrt(count)
    assert errors.std() == pytest.approx(0.02, rel=4 / math.sqrt(2 * count))
    correlations = np.corrcoef(errors.T) - np.eye(RAYS)
    assert np.abs(correlations).max() < 5 / math.sqrt(500)  # each ray errs by itself


def test_range_noise_comes_from_the_seed_and_not_from_the_path() -> None:
    def noisy(seed: int, *, drive: bool) -> list[float]:
        stage = Stage(seed=seed)
        robot = stage.put(0, 0)
        sensor = Range(stage.world, robot)
        if drive:
            for wait_s in Base(stage.world, robot).send_cmd("g"):
                stage.clock.advance(wait_s)
        clean = sensor.get_value().value
        sensor.set_config("noise_m", EALData.of(0.01))
        values: list[float] = (sensor.get_value().value - clean).tolist()
        return values

    still = noisy(1, drive=False)
    assert still == pytest.approx(noisy(1, drive=True), abs=1e-12)
    assert still != noisy(2, drive=False)
