"""Fixes of a tracker reach the robots' pose estimates, judged against the truth of the simulation."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.errors import ConfigError, LocalizationError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig, PoseSection, RobotConfig
from tests.facade.tracking import tracked_fleet

MAKES = ("evbot2", "evbot3", "roomba")
SOURCES = ["odometry", "eye"]


def sim(model: str, x_m: float = 0.0, y_m: float = 0.0, yaw_deg: float = 0.0, **more: Any) -> dict[str, Any]:
    start = {"x_m": x_m, "y_m": y_m, "yaw_deg": yaw_deg}
    return {"plugins": {"sim": {"model": model, "start": start, "calibrated": False, **more}}}


def makes() -> dict[str, Any]:
    return {make: sim(make, 1.8 * place - 1.8, -0.5) for place, make in enumerate(MAKES)}


def true_pose(robot: RobotHandle) -> np.ndarray:
    return np.array(robot["TruePose"].get_value().get().value)


def errors_of(robot: RobotHandle, truth: RobotHandle | None = None) -> tuple[float, float, float]:
    """Return the errors of a robot's Pose in metres and degrees, and the normalised error squared."""
    numbers = np.array(robot["Pose"].send_req("estimate").get().value)
    error = numbers[:3] - true_pose(robot if truth is None else truth)
    error[2] = math.remainder(error[2], math.tau)
    nees = error @ np.linalg.solve(numbers[3:].reshape(3, 3), error)
    return math.hypot(*error[:2]), abs(math.degrees(error[2])), float(nees)


def drive_squares(fleet: Fleet, robots: list[str], squares: int = 1) -> None:
    for _ in range(4 * squares):
        for command in ("f1", "l90"):
            for sent in [fleet[name]["Base"].send_cmd(command) for name in robots]:
                sent.get()


def test_a_tracked_pose_stays_true_where_odometry_alone_does_not(tmp_path: Path) -> None:
    """Uncalibrated robots of each make after a square of 1 m: up to 100 cm off by odometry, 5 mm by the tracker."""
    robots = makes()
    alone = {f"{name}-alone": {**sim(name, 1.8 * place - 1.8, 1.5)} for place, name in enumerate(robots)}
    untracked = {name: {**one, "pose": {}} for name, one in alone.items()}
    with tracked_fleet(tmp_path, {**robots, **untracked}, size_m=12) as fleet:
        drive_squares(fleet, [*robots, *alone])
        fleet.clock.sleep(0.5)
        for name in robots:
            position_m, yaw_deg, _ = errors_of(fleet[name])
            assert position_m < 0.005, name
            assert yaw_deg < 1.0, name
        assert max(errors_of(fleet[name])[0] for name in alone) > 0.3


def test_runs_in_lock_step_repeat(tmp_path: Path) -> None:
    found = []
    for _ in range(2):
        with tracked_fleet(tmp_path, makes(), seed=7) as fleet:
            fleet["evbot2"]["Base"].send_cmd("f0.6").get()
            found.append([fleet[name]["Pose"].send_req("estimate").get().value for name in MAKES])
    assert found[0] == found[1]


@pytest.mark.parametrize("count", [1, pytest.param(20, marks=pytest.mark.slow)])
def test_the_estimate_of_simulated_robots_is_consistent(
    tmp_path: Path, count: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The normalised error over seeds and makes is within wide chi-square bounds; single ones are no outliers."""
    found: list[float] = []
    for seed in range(count):
        with tracked_fleet(tmp_path, makes(), seed=seed) as fleet:
            drive_squares(fleet, list(MAKES))
            found += [errors_of(fleet[name])[2] for name in MAKES]
    with capsys.disabled():
        sys.stdout.write(f"\nNEES of {count} seeds, {len(MAKES)} makes: {np.mean(found):.2f}, most {max(found):.1f}\n")
    assert 0.3 < float(np.mean(found)) < (7.0 if count < 10 else 4.2), found


def test_a_tracker_tells_a_driver_whose_start_is_unknown_where_it_is(tmp_path: Path) -> None:
    robots = {
        "driver": {"plugins": {"evbot3": {"address": "sim://world/body"}}},
        "body": {**sim("evbot3", 1.0, 0.5, 120.0, calibrated=True), "pose": {}},
    }
    with tracked_fleet(tmp_path, robots, markers={"body": 1}) as fleet:
        fleet["driver"]["Base"].send_cmd("f0.5").get()
        fleet.clock.sleep(1.0)
        position_m, yaw_deg, _ = errors_of(fleet["driver"], fleet["body"])
        assert position_m < 0.005
        assert yaw_deg < 1.0


@pytest.mark.parametrize("silent_after_s", [None, 0.0])
def test_a_robot_that_does_not_know_where_it_is_waits_for_its_first_fix(
    tmp_path: Path, silent_after_s: float | None
) -> None:
    """It is sent at once; without a fix, it would be taken for one at the map's origin, where the other one stands."""
    robots = {
        "driver": {"plugins": {"evbot3": {"address": "sim://world/body"}}},
        "body": {**sim("evbot3", 1.0, 0.5, 120.0, calibrated=True), "pose": {}},
        "other": {**sim("roomba", 0.0, 0.0), "pose": {}},
    }
    options: dict[str, Any] = {} if silent_after_s is None else {"silent_after_s": silent_after_s}
    with tracked_fleet(tmp_path, robots, markers={"body": 1}, **options) as fleet:
        journey = fleet.go_to({"driver": (1.3, 0.5)})
        if silent_after_s is None:
            journey.get()
            assert math.dist(true_pose(fleet["body"])[:2], (1.3, 0.5)) < 0.02
        else:
            with pytest.raises(LocalizationError, match="its place is unknown: no fix came within 10 s"):
                journey.get()
            assert math.dist(true_pose(fleet["body"])[:2], (1.0, 0.5)) < 0.001


def test_a_driver_and_the_simulation_of_its_body_in_one_robot_each_estimate() -> None:
    plugins = {"sim": {"model": "evbot3", "start": {"x_m": 1.0, "y_m": 0.0}}, "evbot3": {"address": "sim://world"}}
    config = EALConfigManager.of({"version": 1, "clock": {"rate": "max"}, "robots": {"both": {"plugins": plugins}}})
    with Fleet(config.fleet) as fleet:
        robot = fleet["both"]
        robot["evbot3.Base"].send_cmd("f0.5").get()
        fleet.clock.sleep(0.2)
        assert robot["sim.Pose"].get_value().get().value[0] == pytest.approx(1.5, abs=0.01)
        assert robot["evbot3.Pose"].get_value().get().value[0] == pytest.approx(0.5, abs=0.01)


def test_a_robot_that_is_carried_is_found_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with tracked_fleet(tmp_path, {"roomba": sim("roomba")}) as fleet:
        robot = fleet["roomba"]
        fleet.clock.sleep(1.0)
        robot["TruePose"].set_value([2.0, 1.0, 2.0]).get()
        fleet.clock.sleep(2.0)
        assert errors_of(robot)[0] < 0.01
    assert "localised again from fixes" in "".join(capsys.readouterr())


def test_nonsense_among_its_fixes_does_not_end_a_tracker(tmp_path: Path) -> None:
    with tracked_fleet(tmp_path, {"roomba": sim("roomba")}, has_nonsense=True) as fleet:
        robot = fleet["roomba"]
        fleet.clock.sleep(1.0)
        robot["TruePose"].set_value([2.0, 1.0, 2.0]).get()
        fleet.clock.sleep(2.0)
        assert errors_of(robot)[0] < 0.01


def _with(config: FleetConfig, name: str, robot: RobotConfig) -> FleetConfig:
    return replace(config, robots={**config.robots, name: robot})


def test_a_reload_begins_and_ends_the_forwarding(tmp_path: Path) -> None:
    with tracked_fleet(tmp_path, {"roomba": {**sim("roomba"), "pose": {}}}, markers={"roomba": 1}) as fleet:
        robot, without = fleet["roomba"], fleet.config
        tracked = replace(without.robots["roomba"], pose=PoseSection.model_validate({"from": SOURCES, "marker": 1}))
        for config, follows in ((without, False), (_with(without, "roomba", tracked), True), (without, False)):
            if config is not fleet.config:
                fleet.reload(config)
            x_m, y_m, yaw_rad = true_pose(robot)
            robot["TruePose"].set_value([x_m + 0.6, y_m, yaw_rad]).get()
            fleet.clock.sleep(1.5)
            assert (errors_of(robot)[0] < 0.01) is follows


def test_without_fixes_the_uncertainty_grows_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with tracked_fleet(tmp_path, {"roomba": sim("roomba")}, silent_after_s=3.0) as fleet:
        robot = fleet["roomba"]
        robot["Base"].send_cmd("f0.5").get()
        before = robot["Pose"].send_req("estimate").get().value
        fleet.clock.sleep(4.0)
        drive_squares(fleet, ["roomba"])
        after = robot["Pose"].send_req("estimate").get().value
        assert after[3] + after[7] > 4 * (before[3] + before[7])
        position_m, _, nees = errors_of(robot)
        assert position_m < 0.1
        assert nees < 25
    assert "".join(capsys.readouterr()).count("a tracker gives no fixes") <= 2


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ({"from": ["odometry", "eyes"], "marker": 1}, "the fleet has no robot 'eyes'; did you mean 'eye'?"),
        ({"from": ["odometry", "eye"]}, "a tracker knows 'a' by its marker: give its number under 'marker'"),
        ({"from": ["eye"], "marker": 1}, "'odometry' must be among the sources"),
        ({"from": ["odometry", "eye"], "marker": -1}, "must be at least 0"),
        ({"form": ["odometry"]}, "did you mean 'from'"),
    ],
)
def test_a_wrong_pose_section_is_refused(pose: dict[str, Any], message: str) -> None:
    robots = {"a": {"plugins": {"sim": {"model": "roomba"}}, "pose": pose}, "eye": {"plugins": {"eye": {}}}}
    with pytest.raises(ConfigError, match=message.replace("?", r"\?")):
        EALConfigManager.of({"version": 1, "robots": robots})


def test_numbered_robots_have_numbered_markers() -> None:
    robots = {
        "eye": {"plugins": {"eye": {}}},
        "r{n}": {"count": 3, "pose": {"marker": "{n}", "from": ["odometry", "eye"]}, "plugins": {"sim": {}}},
    }
    fleet = EALConfigManager.of({"version": 1, "robots": robots}).fleet
    assert [int(fleet.robots[f"r{number}"].pose.marker or 0) for number in (1, 2, 3)] == [1, 2, 3]
    robots["other"] = {"pose": {"marker": 2, "from": ["odometry", "eye"]}, "plugins": {"sim": {}}}
    with pytest.raises(ConfigError, match="marker 2 is on 'r2' already"):
        EALConfigManager.of({"version": 1, "robots": robots})


def test_the_pose_key_is_in_the_schema() -> None:
    from eal_actors.managers.config import fleet_schema

    assert '"from"' in json.dumps(fleet_schema())


def test_a_tracker_unplugged_in_mid_motion_lets_the_robot_go_on_by_odometry_until_it_is_too_unsure(
    tmp_path: Path,
) -> None:
    robots = {"r1": {"plugins": {"sim": {"model": "roomba", "start": {"x_m": 0.0, "y_m": 0.0}}}}}
    with tracked_fleet(tmp_path, robots, silent_after_s=3.0) as fleet:
        base = fleet["r1"]["Base"]
        base.set_config("max_uncertainty_m", 0.06).get()
        with pytest.raises(LocalizationError, match="it needs fixes"):
            for _ in fleet.visit("r1", [(1.0, 0.0), (-1.0, 0.0)] * 10, timeout_s=120):
                pass
        assert fleet.clock.now() > 4.0, "it went on by odometry"
        stood = true_pose(fleet["r1"])
        fleet.clock.sleep(1.0)
        assert true_pose(fleet["r1"]) == pytest.approx(stood, abs=1e-3), "it stands"
        assert errors_of(fleet["r1"])[0] < 0.2
