"""Calibrations beside the fleet file, whose own text stays as it is."""

from __future__ import annotations

from pathlib import Path
from textwrap import dedent

import pytest

from eal_actors.device.differential_base import WheelCalibration
from eal_actors.kernel.errors import ConfigError
from eal_actors.lab.calibration.calibration_file import write_calibration
from eal_actors.lab.fleet_edits import with_identity, with_include
from eal_actors.managers.config import EALConfigManager

FOUND = WheelCalibration(track_factor=1.0125, wheel_ratio=0.9975)
FLEET = """\
# The laboratory.
version: 1   # the first
name: lab
robots:
  rob:  # mine
    plugins: {sim: {model: roomba}}
"""


def fleet_file(folder: Path, text: str = FLEET) -> Path:
    file = folder / "lab.yaml"
    file.write_text(dedent(text), encoding="utf-8")
    return file


def write(file: Path, calibration: WheelCalibration = FOUND, robot: str = "rob") -> Path:
    return write_calibration(EALConfigManager.load(file).fleet, robot, calibration, "Found on Monday.\nBy me.").file


def known(file: Path, robot: str = "rob", instance: str = "sim") -> WheelCalibration:
    settings = EALConfigManager.load(file).robot(robot).plugins[instance].settings
    return WheelCalibration.model_validate(settings["calibration"])


def test_the_fleet_heeds_what_was_written_and_keeps_its_text(tmp_path: Path) -> None:
    file = fleet_file(tmp_path)
    written = write(file)
    assert known(file) == FOUND
    assert written == tmp_path / "lab-rob.calibration.yaml"
    assert written.read_text(encoding="utf-8").startswith("# Found on Monday.\n# By me.\nversion: 1\n")
    line = "include: [lab-rob.calibration.yaml]\n"
    assert file.read_text(encoding="utf-8") == FLEET.replace("name: lab\n", f"{line}name: lab\n")


def test_a_second_calibration_replaces_the_first_and_changes_nothing_else(tmp_path: Path) -> None:
    file = fleet_file(tmp_path)
    write(file)
    text = file.read_text(encoding="utf-8")
    write(file, WheelCalibration(track_factor=1.5))
    assert known(file) == WheelCalibration(track_factor=1.5)
    assert file.read_text(encoding="utf-8") == text


def test_the_robot_may_be_in_an_included_file_and_its_plugin_have_a_name_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "robots.yaml").write_text(FLEET.replace("sim: {", "wheels: {plugin: sim, "), encoding="utf-8")
    file = fleet_file(tmp_path, "version: 1\ninclude: [robots.yaml]  # all of them\n")
    write(file)
    assert known(file, instance="wheels") == FOUND
    text = file.read_text(encoding="utf-8")
    assert text == "version: 1\ninclude: [robots.yaml, lab-rob.calibration.yaml]  # all of them\n"


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("version: 1\nname: x\n", "version: 1\ninclude: [c.yaml]\nname: x\n"),
        ("name: x\nversion: 1", "name: x\nversion: 1\ninclude: [c.yaml]\n"),
        ("version: 1\ninclude: [a.yaml, 'b.yaml']\n", "version: 1\ninclude: [a.yaml, 'b.yaml', c.yaml]\n"),
        ("include:\n  - a.yaml  # a\n\nversion: 1\n", "include:\n  - a.yaml  # a\n  - c.yaml\n\nversion: 1\n"),
        ("include:\n- a.yaml\nversion: 1\n", "include:\n- a.yaml\n- c.yaml\nversion: 1\n"),
        ("include: [c.yaml]\nversion: 1\n", "include: [c.yaml]\nversion: 1\n"),
    ],
)
def test_an_include_is_added_in_the_form_that_the_file_has(before: str, after: str) -> None:
    assert with_include(before, "lab.yaml", "c.yaml") == after


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("version: 1\nname: x\n", "version: 1\nnetwork: {identity: me}\nname: x\n"),
        (
            "version: 1\nnetwork:\n  # mine\n  lease_s: 2\n",
            "version: 1\nnetwork:\n  # mine\n  identity: me\n  lease_s: 2\n",
        ),
        ("network: {lease_s: 2}\nversion: 1\n", "network: {identity: me, lease_s: 2}\nversion: 1\n"),
    ],
)
def test_an_identity_is_added_in_the_form_that_the_file_has(before: str, after: str) -> None:
    assert with_identity(before, "lab.yaml", "me") == after


def test_a_form_of_the_network_that_only_people_can_change_is_left_to_them() -> None:
    with pytest.raises(ConfigError, match=r"network: cannot be changed automatically: add `identity: me`"):
        with_identity("version: 1\nnetwork: {}\n", "lab.yaml", "me")


@pytest.mark.parametrize(
    "text", ["{version: 1, name: x}\n", "version: 1\ninclude: []\n", "version: 1\ninclude: ['a]b.yaml']\n"]
)
def test_a_form_that_only_people_can_change_is_left_to_them(text: str) -> None:
    with pytest.raises(ConfigError, match=r"lab\.yaml: include: cannot be changed automatically: add c\.yaml"):
        with_include(text, "lab.yaml", "c.yaml")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (FLEET.replace("roomba}", "roomba, calibration: {track_factor: 1.1}}"), "is set here and would override"),
        (FLEET.replace("rob:", '"rob{n}": {count: 1, plugins: {sim: {model: roomba}}}\n  x:'), "the robot 'rob1' is"),
        (FLEET.replace("sim: {model: roomba}", "sample: {}"), "no plugin with a Base"),
    ],
)
def test_where_the_fleet_would_not_heed_it_both_files_stay_as_they_were(tmp_path: Path, text: str, says: str) -> None:
    file = fleet_file(tmp_path, text)
    with pytest.raises(ConfigError, match=says):
        write(file, robot="rob1" if "{n}" in text else "rob")
    assert file.read_text(encoding="utf-8") == text
    assert [path.name for path in tmp_path.iterdir()] == ["lab.yaml"]


def test_a_folder_that_takes_no_file_is_told(tmp_path: Path) -> None:
    file = fleet_file(tmp_path)
    (tmp_path / ".lab-rob.calibration.yaml.new").mkdir()  # where the file is first written
    with pytest.raises(ConfigError, match=r"lab-rob\.calibration\.yaml: cannot be written: Is a directory"):
        write(file)
    assert file.read_text(encoding="utf-8") == FLEET
