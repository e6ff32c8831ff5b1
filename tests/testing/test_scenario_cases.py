"""`pytest --eal`: scenario files as test cases, in a pytest of their own inside this one."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path
from textwrap import dedent
from xml.etree import ElementTree as Xml

import numpy  # noqa: F401  # a pytest inside this one must not be the first to import it
import pymunk  # noqa: F401
import pytest

import eal_actors.testing.scenario_cases  # noqa: F401

pytest_plugins = ["pytester"]

PLUGIN = "eal_actors.testing.pytest_plugin"
WANTED = "expected value('TruePose')[[]0] to be 0.5 ± 0.01"

FLEET = """\
version: 1
name: trial
seed: 4
robots:
  scout:
    plugins:
      sim: {model: roomba, noise: false, start: {x_m: 0, y_m: 0}}
"""

DRIVE = """\
version: 1
name: drive
parameters:
  metres: {type: double, unit: m, default: 0.5, minimum: 0.1, maximum: 1}
roles: {scouts: {}}
steps:
  - on: scouts
    do:
      - send_cmd: {resource: Base, cmd: "f${metres}"}
      - expect: value('TruePose')[0]
        equals: 0.5
        tolerance: 0.01
        says: it is not there
"""

PLAIN = (
    "version: 1\nname: plain\nroles: {scouts: {}}\nsteps: [{on: scouts, do: [{send_cmd: {resource: Base, cmd: l}}]}]\n"
)


@pytest.fixture
def folder(pytester: pytest.Pytester) -> Path:
    """A folder with a fleet file, a scenario that expects something, and YAML files that are no test cases."""
    scenarios = pytester.path / "scenarios"
    scenarios.mkdir()
    for name, text in (("fleet", FLEET), ("drive", DRIVE), ("plain", PLAIN), ("words", "hello: world\n")):
        (scenarios / f"{name}.yaml").write_text(text)
    return scenarios


def run(pytester: pytest.Pytester, *arguments: str) -> pytest.RunResult:
    is_installed = any(point.value == PLUGIN for point in entry_points(group="pytest11"))
    named = [] if is_installed else ["-p", PLUGIN]
    without = ("-p", "no:cacheprovider", "-p", "no:hypothesispytest", "-p", "no:rerunfailures")  # or threads stay
    options = [*without, "-W", "error", f"--basetemp={pytester.path / 'kept'}"]
    return pytester.runpytest_inprocess(*options, *named, *arguments)


def test_only_a_scenario_with_expectations_is_a_case(pytester: pytest.Pytester, folder: Path) -> None:
    result = run(pytester, "--eal", "-v", "scenarios")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["scenarios/drive.yaml::drive PASSED*"])
    assert not list((pytester.path / "kept").glob("drive*"))  # only failed cases keep their run


def test_without_the_option_no_scenario_is_collected(pytester: pytest.Pytester, folder: Path) -> None:
    assert run(pytester, "scenarios").ret == pytest.ExitCode.NO_TESTS_COLLECTED


@pytest.mark.parametrize("arguments", [("--eal-all", "scenarios"), ("scenarios/plain.yaml", "scenarios/drive.yaml")])
def test_scenarios_without_expectations_run_if_wanted(
    pytester: pytest.Pytester, folder: Path, arguments: tuple[str, ...]
) -> None:
    run(pytester, "--eal", *arguments).assert_outcomes(passed=2)


def test_a_failed_expectation_says_where_what_was_seen_and_what_was_wanted(
    pytester: pytest.Pytester, folder: Path
) -> None:
    result = run(pytester, "--eal", "scenarios", "--eal-set", "metres=0.8", "--eal-seed=11", "--junit-xml=j.xml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        [
            "*scenario drive*",
            f"scenarios/drive.yaml:10:9: steps[[]0].do[[]1] (scout): it is not there: {WANTED}, but it is 0.8*",
            "the run: failed after * s of the fleet's clock",
            f"run folder: {pytester.path}/kept/drive0",
            "fleet scenarios/fleet.yaml, --eal-seed=11",
        ]
    )
    assert (pytester.path / "kept/drive0/events.jsonl").is_file()

    case = Xml.parse(pytester.path / "j.xml").find(".//testcase")  # noqa: S314  # pytest wrote it
    assert case is not None
    properties = {one.attrib["name"]: one.attrib["value"] for one in case.iter("property")}
    assert properties == {
        "eal_fleet": "scenarios/fleet.yaml",
        "eal_seed": "11",
        "eal_run": f"{pytester.path}/kept/drive0",
    }
    failure = case.find("failure")
    assert failure is not None
    assert "scenarios/drive.yaml:10:9" in failure.attrib["message"]


def test_every_expectation_counts_even_where_the_scenario_goes_on(pytester: pytest.Pytester, folder: Path) -> None:
    soft = """
      - expect: 1 > 2
        on_failure: skip
      - expect: 2 > 3
        on_failure: skip
    """
    (folder / "drive.yaml").write_text(
        DRIVE + dedent(soft).strip("\n").replace("\n", "\n      ").join(["      ", "\n"])
    )
    result = run(pytester, "--eal", "scenarios")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*expected 1 > 2 to be true", "*expected 2 > 3 to be true", "the run: done after*"])


def test_other_steps_that_fail_are_told_with_their_place(pytester: pytest.Pytester, folder: Path) -> None:
    (folder / "drive.yaml").write_text(DRIVE.replace("steps:\n", "timeout_s: 0.5\nsteps:\n"))
    result = run(pytester, "--eal", "scenarios")
    result.stdout.fnmatch_lines(
        ["scenarios/drive.yaml:10:9: steps[[]0].do[[]0] (scout): send_cmd Base f0.5 failed: *had no answer within*"]
    )


def test_the_place_of_a_step_in_another_scenario_is_in_that_one_s_file(pytester: pytest.Pytester, folder: Path) -> None:
    (folder / "outer.yaml").write_text(
        "version: 1\nname: outer\nroles: {scouts: {}}\nsteps:\n  - scenario: drive.yaml\n    with: {metres: 0.2}\n"
    )
    result = run(pytester, "--eal", "scenarios/outer.yaml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["scenarios/drive.yaml:10:9: steps[[]0].drive.steps[[]0].do[[]1] (scout)*0.5 ± 0.01*"])


def test_the_fleet_is_that_of_the_command_line_then_of_the_scenario_then_of_the_folder(
    pytester: pytest.Pytester, folder: Path
) -> None:
    for name in ("drive.fleet", "given"):
        (folder / f"{name}.yaml").write_text(FLEET.replace("scout", name.partition(".")[0]))
    own = run(pytester, "--eal", "scenarios", "--eal-set=metres=1")
    own.stdout.fnmatch_lines(["*(drive): it is not there*", "fleet scenarios/drive.fleet.yaml, --eal-seed=4"])
    given = run(pytester, "--eal", "scenarios", "--eal-set=metres=1", "--eal-fleet=scenarios/given.yaml")
    given.stdout.fnmatch_lines(["*(given): it is not there*", "fleet scenarios/given.yaml, --eal-seed=4"])

    for file in ("drive.fleet.yaml", "fleet.yaml"):
        (folder / file).unlink()
    none = run(pytester, "--eal", "scenarios")
    none.stdout.fnmatch_lines(
        ["no fleet for scenarios/drive.yaml: give --eal-fleet FILE; *drive.fleet.yaml nor fleet*"]
    )


def test_nothing_real_is_opened(pytester: pytest.Pytester, folder: Path) -> None:
    real = "version: 1\nrobots: {scout: {plugins: {roomba: {protocol: sci, port: /dev/no-such-port}}}}\n"
    (folder / "fleet.yaml").write_text(real)
    (folder / "drive.yaml").write_text(DRIVE.replace("tolerance: 0.01", "tolerance: 0.1"))
    run(pytester, "--eal", "scenarios").assert_outcomes(passed=1)

    (folder / "fleet.yaml").write_text("version: 1\nrobots: {scout: {plugins: {sample: {}}}}\n")
    refused = run(pytester, "--eal", "scenarios")
    refused.assert_outcomes(failed=1)
    refused.stdout.fnmatch_lines(["*fleet.yaml:2:*robots.scout.plugins.sample: cannot be simulated:*"])


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("--eal-set=meters=1", "*--eal-set: no collected scenario has a parameter 'meters'; did you mean*"),
        ("--eal-set=metres", "*argument --eal-set: must be NAME=VALUE, not 'metres'"),
    ],
)
def test_misspelt_settings_are_refused(pytester: pytest.Pytester, folder: Path, option: str, message: str) -> None:
    result = run(pytester, "--eal", "scenarios", option)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines([message])


def test_a_value_out_of_range_and_a_broken_file_are_told_with_their_lines(
    pytester: pytest.Pytester, folder: Path
) -> None:
    wrong = run(pytester, "--eal", "scenarios", "--eal-set=metres=7")
    wrong.assert_outcomes(failed=1)
    wrong.stdout.fnmatch_lines(["*drive.yaml:4:3: parameters.metres: must be double 0.1..1 m, not 7.0*"])

    (folder / "drive.yaml").write_text(DRIVE.replace("- send_cmd", "- sendcmd"))
    broken = run(pytester, "--eal", "scenarios")
    broken.assert_outcomes(errors=1)
    broken.stdout.fnmatch_lines(["*drive.yaml:9:*sendcmd*"])
