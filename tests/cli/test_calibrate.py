"""`eal calibrate`."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from eal_actors.cli import app
from eal_actors.cli.calibrate import _calibrate, _CalibrationResult, _SquareTest
from eal_actors.cli.output import stderr
from eal_actors.device.differential_base import NOMINAL, WheelCalibration
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.lock_step import MAX
from eal_actors.lab.calibration.drive import calibration_of_base
from eal_actors.lab.calibration.fit import fit_squares
from eal_actors.lab.calibration.square import SquareEnds, square_end, write_square_ends
from eal_actors.managers.config import EALConfigManager
from tests.cli.conftest import Program, Write
from tests.plugin_files import write_plugin

FLEET = """\
version: 1
name: lab  # ours
seed: 3
robots:
  rob: {plugins: {sim: {model: roomba, calibrated: false, start: {x_m: -1, y_m: 0}}}}
  mate: {plugins: {sim: {model: evbot3, calibrated: false, start: {x_m: 1, y_m: 0}}}}
"""
TRUTH = WheelCalibration(track_factor=1.012, wheel_ratio=1.004)


@pytest.fixture
def lab(write: Write) -> Path:
    return write("lab.yaml", FLEET)


@pytest.fixture
def ends(tmp_path: Path) -> Path:
    """End of a Roomba's squares of 1 m without noise."""
    cw, ccw = (square_end(way, 1.0, 0.258, TRUTH)[:2] for way in ("cw", "ccw"))
    write_square_ends(SquareEnds([cw] * 2, [ccw] * 2), tmp_path / "ends.csv")
    return tmp_path / "ends.csv"


def test_a_robot_is_calibrated_proven_and_remembered(eal: Program, lab: Path) -> None:
    result = eal("calibrate", "--fleet", lab, "--robot", "rob", "--fast", "--write", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)["robots"]["rob"]
    assert (found["fit"]["track_factor"], found["fit"]["wheel_ratio"]) == pytest.approx((1.012, 1.004), abs=0.002)
    assert found["factor"] == pytest.approx(found["before"]["error_m"] / found["after"]["error_m"])
    assert found["factor"] > 5
    assert len(found["before"]["cw"]) == len(found["after"]["ccw"]) == 5
    settings = EALConfigManager.load(lab).robot("rob").plugins["sim"].settings
    assert settings["calibration"]["track_factor"] == pytest.approx(found["fit"]["track_factor"], abs=1e-6)
    assert "name: lab  # ours" in lab.read_text(encoding="utf-8")
    again = json.loads(eal("calibrate", "--fleet", lab, "-r", "rob", "--fast", "--json").stdout)["robots"]["rob"]
    assert again["known"] == settings["calibration"]
    assert again["before"]["error_m"] < found["before"]["error_m"] / 5


def test_all_robots_in_a_table(eal: Program, lab: Path) -> None:
    result = eal("calibrate", "--fleet", lab, "--fast", "--seed", 5, "--runs", 3, "--side", 0.8)
    assert result.exit_code == 0, result.output
    assert "E_b" in result.stdout
    assert [line.split()[0] for line in result.stdout.splitlines()[2:4]] == ["rob", "mate"]
    assert "Nothing was written" in result.stdout
    assert lab.read_text(encoding="utf-8") == FLEET


def test_where_nothing_is_gained_nothing_is_written(eal: Program, write: Write) -> None:
    """A robot with large random errors only: the fit is random too."""
    lab = write("lab.yaml", FLEET.replace("calibrated: false", "calibrated: true"))
    arguments = ["calibrate", "--fleet", lab, "-r", "mate", "--fast", "--write", "--runs", 1, "--seed"]
    results = [eal(*arguments, seed) for seed in range(4)]
    codes = [result.exit_code for result in results]
    assert set(codes) == {0, 1}
    first = next(result for result in results if result.exit_code)
    assert "mate: the second run is not better" in first.stdout


@pytest.mark.parametrize("keeps", [True, False])
def test_a_base_keeps_a_calibration_only_if_it_is_written(lab: Path, keeps: bool) -> None:
    """A robot that others serve would drive with it until they restart."""
    config = replace(EALConfigManager.load(lab).fleet, rate=MAX)
    with Fleet(config).connect(["rob"]) as fleet:
        before = calibration_of_base(fleet["rob"])
        result = _calibrate(fleet, "rob", _SquareTest(1.0, 2, None, None, stderr(), keeps))
        assert result.is_better
        assert calibration_of_base(fleet["rob"]) == (result.fit.calibration if keeps else before)


def test_ends_from_a_file(eal: Program, lab: Path, ends: Path) -> None:
    result = eal("calibrate", "--fleet", lab, "--robot", "rob", "--ends", ends, "--write")
    assert result.exit_code == 0, result.output
    assert "1.0120" in result.stdout
    assert "1.0040" in result.stdout
    text = (lab.parent / "lab-rob.calibration.yaml").read_text(encoding="utf-8")
    assert "calibration: {track_factor: 1.012" in text


def test_a_robot_that_is_measured_by_a_person(eal: Program, write: Write) -> None:
    """A driver at a simulated port has no ground truth, like a real one."""
    lab = write("lab.yaml", "version: 1\nrobots: {rob: {plugins: {roomba: {protocol: sci, link: sim}}}}\n")
    answers = ["", "no idea", "-20 11", "", "-3, 40", "", "1 1", "", "0 0"]
    arguments = ["calibrate", "--fleet", str(lab), "--robot", "rob", "--runs", "1", "--side", "0.3", "--fast", "--json"]
    result = CliRunner().invoke(app, arguments, input="\n".join(answers) + "\n")
    assert result.exit_code == 0, result.output
    assert "Enter two numbers, such as" in result.stderr
    found = json.loads(result.stdout)["robots"]["rob"]
    assert found["before"]["cw"][0] == pytest.approx([-0.02, 0.011], abs=0.01)  # less what the odometry believed
    assert found["before"]["ccw"][0] == pytest.approx([-0.003, 0.04], abs=0.01)
    cut = CliRunner().invoke(app, arguments, input="\n")
    assert cut.exit_code == 2
    error = json.loads(cut.stdout)["error"]
    assert "no answer where rob ended" in error["message"]
    assert error["advice"] == "Run the command on a terminal, or name a file with --ends."


WHEELLESS = """\
from eal_actors.plugin import EALPlugin, Resource, ResourceType
class Base(Resource):
    types = ResourceType.ACTUATOR
"""


def test_a_base_of_which_nothing_is_known(eal: Program, write: Write, ends: Path) -> None:
    lab = write("lab.yaml", "version: 1\nplugin_dirs: [plugins]\nrobots: {rob: {plugins: {wheelless: {}}}}\n")
    write_plugin(lab.parent, "wheelless", WHEELLESS, "Base")
    arguments = ["calibrate", "--fleet", lab, "--robot", "rob", "--ends", ends]
    refused = eal(*arguments)
    assert refused.exit_code == 2
    assert "rob: its Base has no wheelbase_m: give it with --wheelbase" in refused.stderr
    assert "eal resources" not in refused.stderr  # it lists nothing that would help
    found = eal(*arguments, "--wheelbase", 0.258)
    assert found.exit_code == 0
    assert "its Base cannot be calibrated" in found.stdout
    assert "--write" not in found.stdout


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--robot", "bob"], "no robot 'bob'; did you mean 'rob'?"),
        (["--ends", "none.csv"], "needs one robot: name it with --robot"),
        (["--robot", "rob", "--ends", "none.csv"], "none.csv: cannot be read"),
        (["--robot", "rob", "--side", "0.01"], "--side"),
    ],
)
def test_wrong_input_is_told(eal: Program, lab: Path, arguments: list[str], says: str) -> None:
    result = eal("calibrate", "--fleet", lab, *arguments)
    assert result.exit_code == 2
    assert says in result.output


def test_a_robot_that_meets_a_wall_is_stopped_and_told(eal: Program, write: Write) -> None:
    write("hall.yaml", "version: 1\nname: hall\nsize_m: [2, 2]\n")
    lab = write("lab.yaml", FLEET.replace("seed: 3", "seed: 3\nworld: hall.yaml").replace("x_m: -1", "x_m: 0"))
    result = eal("calibrate", "--fleet", lab, "--robot", "rob", "--fast", "--write")
    assert result.exit_code == 1
    assert "rob: touches something on side 1 of a square cw: clear the floor" in result.output


def test_a_second_run_without_any_error_is_better() -> None:
    before, after = SquareEnds(((0.1, 0.0),), ((0.0, 0.1),)), SquareEnds(((0.0, 0.0),), ((0.0, 0.0),))
    result = _CalibrationResult("r", 0.2, None, before, fit_squares(before, 1.0, 0.2, NOMINAL), after)
    assert result.is_better
    assert result.factor == math.inf
