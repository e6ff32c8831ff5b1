"""The scenarios in Python, on the simulated fleet."""

from __future__ import annotations

import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from eal_actors import Fleet
from eal_actors.facade import connections
from eal_actors.managers.config import EALConfigManager
from eal_actors.testing import Simulation
from scenarios import dance, panorama, square, square_umbmark, survey, wander
from scenarios.classic import camera as classic_camera
from scenarios.classic import dance as classic_dance
from scenarios.classic import sample_user_code
from scenarios.classic import square as classic_square
from tests.patience import patient_fleet
from tests.plugin_files import write_plugin

SIM = Path(__file__).parents[2] / "fleets" / "sim.yaml"


def fast_fleet() -> Fleet:
    """The simulated fleet, faster than its file says."""
    return patient_fleet(SIM, rate=40)


def pose(fleet: Fleet, name: str) -> tuple[float, float, float]:
    x_m, y_m, yaw_rad = fleet[name]["TruePose"].get_value().get().value
    return float(x_m), float(y_m), float(yaw_rad)


def test_square_comes_back_near_its_start() -> None:
    with fast_fleet() as fleet:
        before = pose(fleet, "evbot3-1")
        square.drive_square(fleet["evbot3-1"])
        after = pose(fleet, "evbot3-1")
    assert 0 < math.dist(before[:2], after[:2]) < 0.3  # as in the thesis, the square is not perfect


def test_dance_turns_every_robot_by_the_sum_of_its_steps() -> None:
    with fast_fleet() as fleet:
        before = {name: pose(fleet, name) for name in fleet}
        assert dance.dance(list(fleet.values())) == list(fleet)
        after = {name: pose(fleet, name) for name in fleet}
    right_deg = 45 - 90 + 90 - 10 + 10 - 10 + 360
    for name in before:
        turned = (before[name][2] - after[name][2] - math.radians(right_deg) + math.pi) % (2 * math.pi) - math.pi
        assert abs(turned) < math.radians(45)
        assert math.dist(before[name][:2], after[name][:2]) < 0.1


def test_programs_find_their_fleets_in_any_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    programs = [file for file in (SIM.parents[1] / "scenarios").glob("*.py") if "--fleet" in file.read_text()]
    names = [re.findall(r'"--fleet", default="(.*?)"', file.read_text()) for file in programs]
    assert len(programs) == 10
    for (name,) in names:
        assert EALConfigManager.load(name).fleet.robots


def test_a_dancer_that_fails_leaves_and_the_others_continue(capsys: pytest.CaptureFixture[str]) -> None:
    with fast_fleet() as fleet:
        name = next(iter(fleet))
        fleet[name].close()
        assert dance.dance(list(fleet.values())) == [other for other in fleet if other != name]
    assert f"{name} leaves the dance at r45" in capsys.readouterr().out


def test_panorama_takes_eight_different_pictures_of_every_robot() -> None:
    with fast_fleet() as fleet:
        taken = panorama.take_panorama(list(fleet.values()))
    for shots in taken.values():
        assert len(shots.frames) == len(shots.yaws_rad) == 8
        assert len({frame.value.tobytes() for frame in shots.frames}) == 8


def test_wander_keeps_off_the_walls_and_ends_in_time() -> None:
    with fast_fleet() as fleet:
        turns, reason = wander.wander(fleet, fleet["roomba-1"], 25.0)
        x_m, y_m, _ = pose(fleet, "roomba-1")
        assert fleet["roomba-1"]["Base"].get_status().get() == 0
    assert reason in ("the time is over", "it touched something")
    assert turns != 0
    assert abs(x_m) < 3.0
    assert abs(y_m) < 2.0


def test_squares_calibrate_the_wheels_and_verify_it(capsys: pytest.CaptureFixture[str]) -> None:
    with Simulation(SIM.with_name("uncalibrated.yaml"), seed=3) as simulation:
        robot = simulation["roomba-1"]
        proof = square_umbmark.prove(robot, squares=2)
        wheels = proof.fit.calibration
        assert robot["Base"].get_config("track_factor").get().value == pytest.approx(wheels.track_factor)
        assert robot["Base"].get_status().get() == 0
    assert proof.before_m > 0.05
    assert proof.after_m < proof.before_m / 3


@pytest.fixture
def classic_fleet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A fast simulated fleet for programs that only know host names."""
    fleet = tmp_path / "fast.yaml"
    fleet.write_text(f"version: 1\ninclude: ['{SIM}']\nclock: {{rate: 40}}\ndefaults: {{timeout_s: 10000}}\n")
    monkeypatch.setenv("EAL_FLEET", str(fleet))
    return fleet


TOGETHER = '''
import threading
from eal_actors.plugin import *

_lock = threading.Lock()
_step = {"begun": 0, "ended": 0}

class Base(Resource):
    """Ends a step when all three robots have begun it."""
    types = ResourceType.ACTUATOR
    def send_cmd(self, cmd, data=None):
        return self._turn()
    def _turn(self):
        with _lock:
            _step["begun"] += 1
            wanted = -(-_step["begun"] // 3) * 3
        while _step["begun"] < wanted:
            yield 0.01
        return 1
'''


def test_classic_sample_user_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert sample_user_code.main() == 0
    assert capsys.readouterr().out.splitlines() == [
        "Available resource: SampleResource",
        "SampleResource value = 0",
        "SampleResource value is now = 42",
    ]


def test_classic_square(classic_fleet: Path) -> None:
    fleet = connections.acquire_fleet(classic_fleet)
    try:
        before = pose(fleet, "roomba-1")
        assert classic_square.main(["square.py", "roomba-1"]) == 0
        after = pose(fleet, "roomba-1")
    finally:
        connections.release_fleet(fleet)
    assert 0 < math.dist(before[:2], after[:2]) < 0.3


def test_classic_programs_end_with_an_error_where_a_call_fails(
    classic_fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert classic_square.main(["square.py", "nobody"]) == 1
    assert classic_camera.main(["camera.py", "nobody", "50000", str(tmp_path)]) == 1
    assert capsys.readouterr().err.splitlines().count("Error connecting to EAL") == 2
    assert classic_dance.main(["dance.py", "nobody"]) == 1
    assert classic_dance.main(["dance.py"]) == classic_camera.main(["camera.py"]) == 2
    assert classic_camera.main(["camera.py", "roomba-1", "50000", str(tmp_path / "no such folder")]) == 1
    monkeypatch.delenv("EAL_FLEET")
    assert classic_square.main(["square.py"]) == 1  # the sample robot has no base
    assert "The robot cannot 'g'" in capsys.readouterr().err


def test_classic_camera_saves_pictures_in_their_colours(classic_fleet: Path, tmp_path: Path) -> None:
    fleet = connections.acquire_fleet(classic_fleet)
    try:
        assert classic_camera.main(["camera.py", "evbot2-1", "50000", str(tmp_path)]) == 0
        last = fleet["evbot2-1"]["Camera"].get_value().get().value
    finally:
        connections.release_fleet(fleet)
    assert sorted(file.name for file in tmp_path.glob("frame.*")) == [f"frame.{i}.jpg" for i in range(7)]
    for file in tmp_path.glob("frame.*"):
        assert file.read_bytes().startswith(b"\xff\xd8\xff")  # a JPEG file
    saved = np.asarray(cv2.imread(str(tmp_path / "frame.6.jpg")))[..., ::-1]
    assert np.abs(saved.mean(axis=(0, 1)) - last.mean(axis=(0, 1))).max() < 2


def test_classic_camera_saves_red_as_red(tmp_path: Path) -> None:
    red = np.zeros((16, 16, 3), np.uint8)
    red[..., 0] = 255  # frames are RGB
    assert classic_camera.saveFrame(red, tmp_path / "frame", 0)
    blue_value, _, red_value = np.asarray(cv2.imread(str(tmp_path / "frame.0.jpg")))[8, 8]
    assert red_value > 200 > 50 > blue_value


def test_classic_dance(classic_fleet: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fleet = connections.acquire_fleet(classic_fleet)
    try:
        before = {name: pose(fleet, name) for name in fleet}
        assert classic_dance.main(["dance.py", *fleet, "nobody"]) == 1
        after = {name: pose(fleet, name) for name in fleet}
    finally:
        connections.release_fleet(fleet)
    assert all(not np.isclose(before[name][2], after[name][2], atol=0.1) for name in before)
    assert "finished the dance: evbot2-1, evbot3-1, roomba-1" in capsys.readouterr().out


def test_classic_dance_at_the_rate_max(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        'version: 1\nclock: {rate: max}\nrobots: {"r{n}": {count: 2, plugins: {sim: {model: roomba, noise: false}}}}\n'
    )
    monkeypatch.setenv("EAL_FLEET", str(fleet))
    monkeypatch.setattr(classic_dance, "DANCE", ["r45", "l90"])
    assert classic_dance.main(["dance.py", "r1", "r2"]) == 0
    shown = capsys.readouterr()
    assert "finished the dance: r1, r2" in shown.out
    assert "time advances without it" not in shown.out + shown.err  # nothing waits for anything but the clock


def test_classic_dancers_move_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_plugin(tmp_path, "together", TOGETHER, "Base")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text(
        "version: 1\nplugin_dirs: [plugins]\ndefaults: {timeout_s: 100, "
        "plugins: {together: {}}}\nrobots: {one: {}, two: {}, three: {}}\n"
    )
    monkeypatch.setenv("EAL_FLEET", str(fleet))
    assert classic_dance.main(["dance.py", "one", "two", "three"]) == 0


def test_survey_knows_its_yaw_by_the_imu_and_meets_the_walls() -> None:
    with Fleet.load(SIM.with_name("survey.yaml")) as fleet:
        points, yaw_rad = survey.survey(fleet["surveyor"], fleet.clock)
        _, _, true_rad = pose(fleet, "surveyor")
    assert math.remainder(yaw_rad - true_rad, 2 * math.pi) == pytest.approx(0.0, abs=math.radians(1))
    assert len(points) == 360
    # It faces east, 3.7 m from the east wall, 3.2 m from the south wall, 2.2 m from the bench on its left.
    assert points[:, 0].max() == pytest.approx(3.7, abs=0.1)
    assert points[:, 1].min() == pytest.approx(-3.2, abs=0.1)
    assert np.median(points[(np.abs(points[:, 0]) < 1) & (points[:, 1] > 0), 1]) == pytest.approx(2.2, abs=0.1)
