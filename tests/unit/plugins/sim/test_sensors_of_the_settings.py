"""Lidar, IMU and depth camera: the sensors that a robot's settings add to it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from eal_actors.device.world import load_world
from eal_actors.kernel.bundled import bundled_path
from eal_actors.plugin import EALData
from eal_actors.testing import Simulation
from plugins.sim import plugin as sim
from plugins.sim.camera.eye import PinholeLens
from plugins.sim.camera.scene import Scene
from plugins.sim.camera.shared import movers_of
from plugins.sim.models import MAKES
from plugins.sim.resources.camera import mounted_eye
from plugins.sim.resources.depth_camera import depths_m
from tests.unit.plugins.sim import ray_caster
from tests.unit.plugins.sim.rig import Fleet, Robot, arena

Array = NDArray[np.float64]
SENSORS = {"lidar": "Lidar", "imu": "Imu", "depth_camera": "DepthCamera"}
FURNISHED = arena(
    7.0,
    5.0,
    obstacles=(
        {"kind": "box", "x_m": 1.9, "y_m": -1.2, "size_m": (1.6, 0.8), "yaw_deg": 30.0, "height_m": 0.3},
        {"kind": "box", "x_m": 0.0, "y_m": 2.2, "size_m": (4.0, 0.6), "height_m": 1.8},
        {"kind": "circle", "x_m": 2.9, "y_m": 1.9, "radius_m": 0.2, "height_m": 0.5},
        {"kind": "wall", "start_m": (-1.5, -2.5), "end_m": (-1.2, -1.2)},
    ),
    boxes=({"name": "crate", "x_m": 2.6, "y_m": 0.6, "size_m": (0.35, 0.25), "yaw_deg": 20.0},),
    beacons=({"name": "dock", "x_m": 3.2, "y_m": -0.3},),
)
LAB = load_world(bundled_path("fleets/worlds/lab.yaml"))
EXACT_IMU = dict.fromkeys(
    ("acceleration_noise_m_s2", "acceleration_bias_m_s2", "turn_rate_noise_rad_s", "turn_rate_bias_rad_s"), 0.0
)


def value(robot: Robot, name: str) -> Array:
    found: Array = robot.resource(name).get_value().value
    return found


# In the settings.


@pytest.mark.parametrize(("key", "name"), SENSORS.items())
def test_a_sensor_is_there_if_the_settings_have_it(key: str, name: str) -> None:
    assert name in sim.Settings.model_validate({"model": "roomba", key: {}}).resources
    assert name not in sim.Settings.model_validate({"model": "roomba"}).resources
    with pytest.raises(ValidationError, match=f"has no {name} to freeze"):
        sim.Settings.model_validate({"model": "roomba", "faults": [{"at_s": 0, "frozen": [name]}]})


@pytest.mark.parametrize(
    "wrong",
    [
        {"lidar": {"rays": 1}},
        {"lidar": {"fov_deg": 361}},
        {"lidar": {"range_m": 3}},
        {"imu": {"turn_rate_noise_rad_s": -1}},
        {"depth_camera": {"width": 5000}},
    ],
)
def test_impossible_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        sim.Settings.model_validate({"model": "roomba", **wrong})


# The lidar.


@pytest.mark.parametrize(("fov_deg", "rays"), [(360.0, 720), (270.0, 541), (90.0, 2)])
def test_lidar_rays_agree_with_the_physics_engine(fov_deg: float, rays: int) -> None:
    fleet = Fleet(LAB)
    settings = {"rays": rays, "fov_deg": fov_deg, "max_range_m": 6, "noise_m": 0}
    robot = fleet.add("r1", (0.5, 0.3, 77), lidar=settings)
    fleet.add("r2", (1.2, 1.0, 0), model="evbot2")
    angles_rad: Array = robot.resource("Lidar").send_req("angles").value
    assert angles_rad.shape == (rays,)
    assert math.degrees(angles_rad[0]) == pytest.approx(-fov_deg / 2)
    pitch_deg = fov_deg / rays if fov_deg == 360 else fov_deg / (rays - 1)
    assert np.degrees(np.diff(angles_rad)) == pytest.approx(pitch_deg)

    simulated = robot.plugin.robot
    x_m, y_m, yaw_rad = simulated.pose
    expected = []
    for angle_rad in (yaw_rad + angles_rad).tolist():
        end = x_m + 6 * math.cos(angle_rad), y_m + 6 * math.sin(angle_rad)
        hit = simulated.space.segment_query_first((x_m, y_m), end, 0.0, simulated.filter)
        expected.append(hit.alpha * 6 if hit else 6.0)
    np.testing.assert_allclose(value(robot, "Lidar"), expected, atol=0.002)


def test_lidar_range_and_noise_are_those_of_the_settings_and_of_set_config() -> None:
    robot = Fleet(arena(20, 20)).add("r1", (0, 0, 0), lidar={"rays": 500, "max_range_m": 11, "noise_m": 0.05})
    sensor = robot.resource("Lidar")
    noisy = np.array([sensor.get_value().value for _ in range(40)])
    sensor.set_config("noise_m", EALData.of(0.0))
    clean = sensor.get_value().value
    near = clean < 10.5
    assert clean.max() == 11
    assert clean.min() == pytest.approx(10)
    assert (noisy[:, clean == 11] == 11).all(), "nothing is there to measure"
    assert (noisy - clean)[:, near].std() == pytest.approx(0.05, rel=0.05)
    assert abs((noisy - clean)[:, near].mean()) < 0.002
    sensor.set_config("max_range_m", EALData.of(5.0))
    assert (sensor.get_value().value == 5).all()
    assert sensor.get_value().frame_id == "r1/base"


# The IMU.


def test_an_imu_at_rest_measures_gravity_within_its_noise_and_bias() -> None:
    robot = Fleet().add("r1", (0, 0, 0), imu={})
    sensor = robot.resource("Imu")
    seen = np.array([sensor.get_value().value for _ in range(2000)])
    settings = robot.context.settings.imu
    spread = [settings.acceleration_noise_m_s2] * 3 + [settings.turn_rate_noise_rad_s] * 3
    assert seen.std(axis=0) == pytest.approx(spread, rel=0.1)
    bias = seen.mean(axis=0) - (0, 0, 9.81, 0, 0, 0)
    assert (np.abs(bias) < [0.2] * 3 + [0.008] * 3).all()
    assert (np.abs(bias) > np.array(spread) / 20).any(), "each unit has an error of its own"
    other = Fleet(seed=2).add("r1", (0, 0, 0), imu={}).resource("Imu")
    assert np.mean([other.get_value().value for _ in range(100)], axis=0) != pytest.approx(seen.mean(axis=0), rel=1e-3)
    assert sensor.send_req("acceleration").unit == "m/s^2"
    assert sensor.send_req("turn_rate").value.shape == (3,)


def test_the_turn_rate_adds_up_to_the_true_turn_and_the_acceleration_to_the_speed() -> None:
    fleet = Fleet(arena(12, 12))
    robot = fleet.add("r1", (0, 0, 0), model="evbot3", noise=True, imu=EXACT_IMU)
    sensor, tick_s = robot.resource("Imu"), robot.plugin.world.tick_s
    fastest_m_s = turned_rad = speed_m_s = 0.0
    for text in ("l200", "f2"):
        motion = robot.base.send_cmd(text)
        next(motion)
        while robot.plugin.robot.motion is not None:
            fleet.clock.advance(tick_s)
            ahead, _, up, _, _, turn_rate = sensor.get_value().value.tolist()
            turned_rad += turn_rate * tick_s
            speed_m_s += ahead * tick_s if text == "f2" else 0.0
            fastest_m_s = max(fastest_m_s, speed_m_s)
            assert up == 9.81
        motion.close()
    true_rad = robot.plugin.robot.pose[2]
    assert true_rad == pytest.approx(math.radians(200), abs=0.2)
    assert turned_rad == pytest.approx(true_rad, abs=0.02)  # all but the last ticks
    assert fastest_m_s == pytest.approx(robot.plugin.robot.make.speed_m_s, abs=0.05)
    assert value(robot, "Imu").tolist() == [0, 0, 9.81, 0, 0, 0]


def test_an_imu_on_a_circle_measures_the_acceleration_towards_its_middle() -> None:
    fleet = Fleet(arena(12, 12))
    robot = fleet.add("r1", (0, 0, 0), imu=EXACT_IMU)
    with robot.plugin.world.lock:
        robot.plugin.world.catch_up()
        robot.plugin.world.drive(robot.plugin.robot, 0.2, 0.4)
    fleet.clock.advance(4.0)
    ahead, left, _, _, _, turn_rate = value(robot, "Imu").tolist()
    assert turn_rate == pytest.approx(0.2 / MAKES["roomba"].track_m, rel=1e-6)
    assert left == pytest.approx(0.3 * turn_rate, rel=1e-3)
    assert ahead == pytest.approx(0.0, abs=1e-3)


# The depth camera.


@pytest.mark.parametrize(
    ("make", "pose", "size"),
    [
        ("evbot3", (-0.6, -0.9, 42), (80, 60)),
        ("roomba", (0.8, -0.2, 20), (75, 61)),
        ("evbot2", (-2.6, 0.6, -25), (60, 81)),
    ],
)
def test_depths_agree_with_a_ray_cast_for_each_pixel(
    make: str, pose: tuple[float, float, float], size: tuple[int, int]
) -> None:
    """The reference shares the solids of the colour camera, and no geometry with the depth camera."""
    fleet = Fleet(FURNISHED)
    robot = fleet.add("eye", pose, model=make)
    fleet.add("a", (0.4, 0.3, 200), model="evbot2")
    fleet.add("b", (1.5, 0.1, 150), model="roomba")
    fleet.add("c", (1.9, 1.6, 250), model="evbot3")
    world, simulated = robot.plugin.world, robot.plugin.robot
    with world.lock:
        world.catch_up()
        eye = mounted_eye(world, simulated, PinholeLens(*size, 70.0))
        found_m = depths_m(world, simulated, eye)
        movers = movers_of(world, simulated)
    true_m = ray_caster.depths(Scene(FURNISHED), movers, eye)
    differs = np.abs(found_m - true_m) > 1e-6
    assert differs.mean() < 0.002, "single pixels at edges may fall on either side"
    assert np.ptp(true_m) > 2


def test_a_wall_straight_ahead_has_one_depth_and_noise_grows_with_its_square() -> None:
    hall = arena(6, 6).model_copy(update={"height_m": 40.0})
    robot = Fleet(hall).add("r1", (0, 0, 0), depth_camera={"width": 64, "height": 48, "noise_m": 0})
    sensor = robot.resource("DepthCamera")
    picture = sensor.get_value()
    assert (picture.value.dtype, picture.value.shape, picture.unit) == (np.float32, (48, 64), "m")
    assert picture.frame_id == "r1/camera"
    assert (picture.value[:24] == 3).all()
    assert sensor.send_req("intrinsics").value[0, 0] == pytest.approx(32 / math.tan(math.radians(57) / 2))
    for depth_m in (3.0, 1.0):
        robot.pose_sensor.set_value(EALData.of([3.0 - depth_m, 0.0, 0.0]))
        sensor.set_config("noise_m", EALData.of(0.002))
        errors = np.array([sensor.get_value().value[:24] - depth_m for _ in range(20)])
        assert errors.std() == pytest.approx(0.002 * depth_m**2, rel=0.03)
    sensor.set_config("max_range_m", EALData.of(0.5))
    assert (sensor.get_value().value[:24] == 0.5).all()


# All of them.


@pytest.mark.parametrize(("key", "name"), SENSORS.items())
def test_noise_comes_from_the_seed_and_no_other_sensor_changes_it(key: str, name: str) -> None:
    def read(seed: int, *others: str) -> list[Any]:
        robots = {"a": {"plugins": {"sim": {"model": "evbot3", key: {}, **{other: {} for other in others}}}}}
        with Simulation(robots, seed=seed) as simulation:
            found = []
            for _ in range(3):
                simulation.advance(0.1)
                for other in others:
                    simulation["a"][SENSORS[other]].get_value().get()
                found.append(simulation["a"][name].get_value().get().value.tolist())
            return found

    others = [other for other in SENSORS if other != key]
    assert read(1) == read(1, *others)
    assert read(1) != read(2)
    assert len({str(one) for one in read(1)}) == 3


@pytest.mark.parametrize(("key", "name"), SENSORS.items())
def test_a_frozen_sensor_repeats_its_last_answer(key: str, name: str) -> None:
    with Simulation({"a": {"plugins": {"sim": {"model": "evbot3", key: {}}}}}) as simulation:
        sensor = simulation["a"][name]
        before = sensor.get_value().get()
        simulation.inject("a", frozen=[name])
        simulation.advance(1.0)
        after = sensor.get_value().get()
        assert (after.stamp_s, after.value.tolist()) == (before.stamp_s, before.value.tolist())
