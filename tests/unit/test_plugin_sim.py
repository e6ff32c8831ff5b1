"""plugins/sim: simulated robots drive, and sense."""

import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from pydantic import ValidationError

from eal_actors.clock import ManualClock
from eal_actors.errors import ArgumentError, PluginError, UnavailableError
from eal_actors.plugin import EALData, FleetServices, PluginContext, Resource, WorldModel
from plugins.sim import plugin as sim
from plugins.sim.resources import Base

TICK_S = 0.02


def arena(width_m: float = 6.0, height_m: float = 4.0, obstacles: Iterable[dict[str, Any]] = ()) -> WorldModel:
    return WorldModel.model_validate(
        {"version": 1, "name": "arena", "size_m": (width_m, height_m), "obstacles": tuple(obstacles)}
    )


class Fleet:
    """Robots of the sim plugin on one clock that stands still between commands."""

    def __init__(self, world: WorldModel | None = None, seed: int = 1) -> None:
        self.clock = ManualClock()
        self.services = FleetServices(self.clock, seed, world)

    def add(self, name: str, start: tuple[float, float, float] | None = None, **settings: Any) -> "Robot":
        place = dict(zip(("x_m", "y_m", "yaw_deg"), start, strict=True)) if start else None
        checked = sim.Settings.model_validate({"model": "roomba", "noise": False, "start": place, **settings})
        context = PluginContext(name, "sim", checked, self.services)
        return Robot(self, PluginContext(name, "sim", checked, self.services, sim.connect(context)))

    def run(self, *activities: Any) -> list[Any]:
        """Step activities side by side until all are over, and return their results."""
        results: list[Any] = [None] * len(activities)
        running = dict(enumerate(activities))
        while running:
            waits = []
            for index, activity in list(running.items()):
                try:
                    waits.append(next(activity))
                except StopIteration as done:
                    results[index] = done.value
                    del running[index]
            if waits:
                assert min(waits) > 0
                self.clock.advance(min(waits))
        return results


class Robot:
    def __init__(self, fleet: Fleet, context: PluginContext) -> None:
        self.fleet = fleet
        self.plugin: sim.SimPlugin = context.plugin
        self.name = context.robot
        self.base = sim.create_Base(context)
        self.pose_sensor = sim.create_Pose(context)
        self.bump = sim.create_Bump(context)
        self.range = sim.create_Range(context)
        self.camera = sim.create_Camera(context)

    @property
    def pose(self) -> list[float]:
        values: list[float] = self.pose_sensor.get_value().value.tolist()
        return values

    def do(self, *commands: str) -> None:
        for text in commands:
            assert self.fleet.run(self.base.send_cmd(text)) == [1]


# The plugin and its settings.


def test_connect_offers_what_the_manifest_names() -> None:
    robot = Fleet().add("r1")
    manifest = yaml.safe_load(Path(sim.__file__).with_name("plugin.yaml").read_text(encoding="utf-8"))
    assert list(robot.plugin.list_resources()) == manifest["resources"]
    for name in manifest["resources"]:
        assert callable(getattr(sim, f"create_{name}"))
        assert getattr(sim, f"destroy_{name}")(robot.base) is None


@pytest.mark.parametrize(
    "settings", [{}, {"model": "evbot9"}, {"model": "roomba", "start": {"x_m": 0.0}}, {"modle": 1}]
)
def test_settings_are_strict(settings: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        sim.Settings.model_validate(settings)


@pytest.mark.parametrize("start", [(2.9, 0, 0), (9, 0, 0), (0, -2.1, 0), (1.0, 1.0, 0), (-1.2, -1.0, 0)])
def test_a_start_that_is_not_free_is_refused(start: tuple[float, float, float]) -> None:
    fleet = Fleet(arena(obstacles=[{"kind": "circle", "x_m": 1.2, "y_m": 1.0, "radius_m": 0.1}]))
    fleet.add("there", (-1.0, -1.0, 0))
    with pytest.raises(PluginError, match="'r1' cannot start"):
        fleet.add("r1", start)


def test_places_are_given_in_the_order_of_names_whoever_joins_first() -> None:
    def places(names: Iterable[str]) -> dict[str, list[float]]:
        fleet = Fleet()
        robots = [fleet.add(name) for name in names]
        return {robot.name: robot.pose for robot in robots}

    names = [f"r{number}" for number in range(9)]
    assert places(names) == places(reversed(names))
    assert len({tuple(pose) for pose in places(names).values()}) == len(names)


def test_a_full_world_has_no_place_left() -> None:
    fleet = Fleet(arena(1.0, 1.0))
    first, second = fleet.add("a"), fleet.add("b")
    assert first.pose == [0, 0, 0]
    with pytest.raises(UnavailableError, match="no free place for robot 'b'"):
        second.pose_sensor.get_value()
    with pytest.raises(UnavailableError):
        fleet.run(second.base.send_cmd("g"))
    second.base.halt()


def test_a_robot_that_joins_again_is_where_it_was() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    motion = robot.base.send_cmd("g")
    next(motion)
    fleet.clock.advance(1.0)
    sim.disconnect(robot.plugin)
    left_at = robot.pose
    fleet.clock.advance(1.0)
    again = fleet.add("r1", (0, 0, 0))
    assert again.pose == left_at
    assert again.base.get_status() == 0
    with pytest.raises(PluginError, match="already"):
        fleet.add("r1", model="evbot3")


# Driving.


@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
@pytest.mark.parametrize(
    ("commands", "pose"),
    [
        (["g"], [0.5, 0, 0]),
        (["b"], [-0.5, 0, 0]),
        (["r"], [0, 0, -math.pi / 2]),
        (["l"], [0, 0, math.pi / 2]),
        (["r45", "f0.25"], [0.25 / math.sqrt(2), -0.25 / math.sqrt(2), -math.pi / 4]),
        (["l12.5", "b1.25"], [-1.25 * math.cos(math.pi / 14.4), -1.25 * math.sin(math.pi / 14.4), math.pi / 14.4]),
        (["r0", "f0"], [0, 0, 0]),
        (["l360"], [0, 0, 0]),
        (["g", "r", "g", "r", "g", "r", "g", "r", "s", "l", "b", "l", "b", "l", "b", "l", "b", "s"], [0, 0, 0]),
    ],
)
def test_without_noise_commands_are_exact(model: str, commands: list[str], pose: list[float]) -> None:
    robot = Fleet().add("r1", (0, 0, 0), model=model)
    for text in commands:
        if text == "s":
            assert robot.base.send_cmd("s") == 1
        else:
            robot.do(text)
    assert robot.pose == pytest.approx(pose, abs=1e-9)
    assert robot.base.get_status() == 0


def test_yaw_is_wrapped_and_the_pose_says_frame_and_time() -> None:
    robot = Fleet().add("r1", (0, 0, 180))
    data = robot.pose_sensor.get_value()
    assert (data.value.dtype, data.value.shape, data.frame_id, data.stamp_s) == (np.float64, (3,), "world", 0)
    assert data.value[2] == math.pi
    robot.do("l90")
    data = robot.pose_sensor.get_value()
    assert data.value[2] == pytest.approx(-math.pi / 2)
    assert data.stamp_s == pytest.approx(robot.fleet.clock.now(), abs=TICK_S)


@pytest.mark.parametrize("stop", [Base.halt, lambda base: base.send_cmd("s")], ids=["halt", "s"])
def test_a_stop_in_the_middle_holds_at_once(stop: Callable[[Base], Any]) -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    motion = robot.base.send_cmd("f2")
    next(motion)
    fleet.clock.advance(2.0)
    assert robot.base.get_status() == 1
    stop(robot.base)
    at = robot.pose
    assert 0.3 < at[0] < 0.6
    assert robot.base.get_status() == 0
    fleet.clock.advance(2.0)
    assert robot.pose == at
    motion.close()


def test_closing_an_activity_stops_only_its_own_motion() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    first, second = robot.base.send_cmd("f2"), robot.base.send_cmd("l90")
    next(first)
    fleet.clock.advance(1.0)
    next(second)
    first.close()
    assert robot.base.get_status() == 1
    second.close()
    assert robot.base.get_status() == 0


def test_configuration_changes_speeds_and_step() -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (0, 0, 0))
    robot.base.set_config("speed_m_s", EALData.of(0.1))
    robot.base.set_config("turn_rate_deg_s", EALData.of(30))
    robot.base.set_config("step_m", EALData.of(1))
    assert [robot.base.get_config(key) for key in ("speed_m_s", "turn_rate_deg_s", "step_m")] == [0.1, 30.0, 1.0]
    robot.do("g")
    assert robot.pose[0] == pytest.approx(1.0)
    drive_s = fleet.clock.now()
    assert 10 < drive_s < 10.5
    robot.do("l90")
    assert 3 < fleet.clock.now() - drive_s < 3.5
    with pytest.raises(ArgumentError, match=r"the roomba reaches 0\.5"):
        robot.base.set_config("speed_m_s", EALData.of(0.55))
    with pytest.raises(ArgumentError):
        robot.base.send_cmd("l3601")


def test_two_robots_move_at_once_and_one_more_stands() -> None:
    fleet = Fleet()
    one, two, still = fleet.add("a", (-1, 0, 0)), fleet.add("b", (1, 0, 90)), fleet.add("c", (0, 1.5, 0))
    assert fleet.run(one.base.send_cmd("g"), two.base.send_cmd("g")) == [1, 1]
    assert one.pose == pytest.approx([-0.5, 0, 0], abs=1e-9)
    assert two.pose == pytest.approx([1, 0.5, math.pi / 2], abs=1e-9)
    assert still.pose == [0, 1.5, 0]


# Touching.


@pytest.mark.parametrize("x_m", [2.5, 2.503])
@pytest.mark.parametrize("model", ["evbot2", "evbot3", "roomba"])
def test_a_wall_holds_and_the_motion_still_ends(model: str, x_m: float) -> None:
    fleet = Fleet()
    robot = fleet.add("r1", (x_m, 0, 0), model=model)
    wall_m = 3.0 - robot.plugin.robot.make.radius_m
    motion = robot.base.send_cmd("f3")
    deepest_m, statuses = 0.0, set()
    for _ in motion:
        fleet.clock.advance(TICK_S)
        deepest_m = max(deepest_m, robot.pose[0] - wall_m)
        statuses.add(robot.base.get_status())
    assert statuses == {0, 1, 2}
    assert deepest_m < 0.002
    end_m = robot.pose[0]
    assert robot.pose == pytest.approx([wall_m, 0, 0], abs=0.001)
    robot.do("b1")
    assert robot.pose == pytest.approx([end_m - 1, 0, 0], abs=1e-6)


def test_a_standing_robot_is_not_pushed() -> None:
    fleet = Fleet()
    mover, still = fleet.add("a", (0, 0, 0)), fleet.add("b", (0.6, 0, 0))
    mover.do("f1")
    assert still.pose == [0.6, 0, 0]
    assert mover.pose[0] == pytest.approx(0.6 - 0.34, abs=0.002)
    assert mover.bump.get_value().value is True
    assert still.bump.get_value().value is False  # it is touched from behind


@pytest.mark.parametrize(
    ("bearing_deg", "left", "right"), [(0, True, True), (45, True, False), (-45, False, True), (120, False, False)]
)
def test_bump_tells_the_side(bearing_deg: float, left: bool, right: bool) -> None:
    bearing_rad = math.radians(bearing_deg)
    pillar = {
        "kind": "circle",
        "radius_m": 0.1,
        "x_m": 0.271 * math.cos(bearing_rad),
        "y_m": 0.271 * math.sin(bearing_rad),
    }
    bump = Fleet(arena(obstacles=[pillar])).add("r1", (0, 0, 0)).bump
    assert (bump.send_req("left").value, bump.send_req("right").value) == (left, right)
    assert bump.get_value().value is (left or right)


def test_nothing_near_presses_nothing() -> None:
    robot = Fleet().add("r1", (2.8, 0, 0))  # 30 mm from the wall
    assert robot.bump.get_value().value is False


# Range and camera.


def test_ranges_fit_the_geometry() -> None:
    box = {"kind": "box", "x_m": 0.0, "y_m": 1.5, "width_m": 2.0, "height_m": 0.2, "yaw_deg": 0.0}
    turned = {"kind": "box", "x_m": -1.5, "y_m": 0.0, "width_m": 0.2, "height_m": 1.0, "yaw_deg": 45.0}
    pillar = {"kind": "circle", "x_m": 0.0, "y_m": -1.0, "radius_m": 0.25}
    fleet = Fleet(arena(10, 8, [box, turned, pillar]))
    robot = fleet.add("r1", (0, 0, 0))
    fleet.add("r2", (3.0, 0, 0))
    data = robot.range.get_value()
    ranges = data.value
    assert (ranges.shape, ranges.dtype, data.unit, data.frame_id) == ((16,), np.float64, "m", "r1/base")
    assert ranges[0] == pytest.approx(3.0 - 0.17)  # the other robot
    assert ranges[1] == 4.0  # the wall at 5 / cos(22.5 deg) is too far
    assert ranges[4] == pytest.approx(1.4)  # the box, on the left
    assert ranges[3] == pytest.approx(1.4 / math.cos(math.pi / 8))
    assert ranges[8] == pytest.approx(1.5 - 0.1 * math.sqrt(2))  # the turned box, behind
    assert ranges[12] == pytest.approx(0.75)  # the pillar, on the right
    robot.do("r90")
    assert robot.range.get_value().value[0] == pytest.approx(0.75)
    angles = robot.range.send_req("angles").value
    assert angles == pytest.approx([math.radians(22.5 * ray) for ray in range(16)])


def test_range_noise_comes_from_the_seed_and_not_from_the_path() -> None:
    def noisy(seed: int, commands: list[str]) -> list[float]:
        robot = Fleet(seed=seed).add("r1", (0, 0, 0), noise=True)
        robot.do(*commands)
        clean = robot.range.get_value().value
        robot.range.set_config("noise_m", EALData.of(0.01))
        values: list[float] = (robot.range.get_value().value - clean).tolist()
        return values

    still = noisy(1, [])
    assert still == pytest.approx(noisy(1, ["g"]), abs=1e-12)
    assert still != noisy(2, [])
    assert 0.003 < float(np.std(still)) < 0.03


def test_the_camera_is_a_test_card_that_turns_with_the_robot() -> None:
    robot = Fleet().add("r1", (0, 0, 0))
    ahead = robot.camera.get_value().value
    assert (ahead.shape, ahead.dtype) == ((240, 320, 3), np.uint8)
    assert (robot.camera.get_config("height"), robot.camera.get_config("width")) == ahead.shape[:2]
    assert "not a view of the world" in robot.camera.info().description
    np.testing.assert_array_equal(ahead, robot.camera.get_value().value)
    robot.do("l30")  # half the field of view: what was at the left edge is in the middle
    turned = robot.camera.get_value().value
    np.testing.assert_allclose(turned[0, 160:].astype(int), ahead[0, :160], atol=1)
    lettering = (slice(24, 108), slice(58, 262))
    assert set(np.unique(ahead[lettering])) == {0, 255}
    np.testing.assert_array_equal(turned[lettering], ahead[lettering])  # TEST stays where it is
    with pytest.raises(ArgumentError, match="read-only"):
        robot.camera.set_config("width", EALData.of(640))


@pytest.mark.parametrize(
    "create", [sim.create_Base, sim.create_Pose, sim.create_Bump, sim.create_Range, sim.create_Camera]
)
def test_values_keep_what_the_information_promises(create: Callable[[PluginContext], Resource]) -> None:
    robot = Fleet().add("r1", (0, 0, 0))
    resource = create(PluginContext("r1", "sim", None, robot.fleet.services, robot.plugin))
    info = resource.info()
    assert info.description
    assert "." not in info.description.rstrip(".").replace("2.", "")
    if info.value:
        info.value.check(resource.get_value(), info.name)
    for known in info.requests:
        assert known.returns is not None
        known.returns.check(resource.send_req(known.name), known.name)
