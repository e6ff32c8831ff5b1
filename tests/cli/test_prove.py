"""`eal prove` and `pytest --eal-prove`: the table, the page, JSON, and input that is wrong."""

from __future__ import annotations

import json
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import pytest

from tests.proof.planted import PLANTED
from tests.scenario_texts import scenario_of

pytest_plugins = ["pytester"]

PLUGINS = ("eal_actors.testing.pytest_plugin", "eal_actors.lab.proof.pytest_plugin")
BUG = next(bug for bug in PLANTED if bug.name == "a-fixed-pause-stands-for-the-way-being-clear")


def test_a_fault_that_nobody_declares_is_refused(eal: Any, tmp_path: Path) -> None:
    scenario, fleet = BUG.write(tmp_path)
    result = eal("prove", scenario, "--fleet", fleet, "--fault", "meteor", "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert "there is no fault 'meteor'; use fails, hangs, slow, lost," in " ".join(result.output.split())


def test_a_folder_that_is_no_proof_is_left_alone(eal: Any, tmp_path: Path) -> None:
    scenario, fleet = BUG.write(tmp_path)
    result = eal("prove", scenario, "--fleet", fleet, "--out", tmp_path)
    assert result.exit_code != 0
    assert "is not the folder of a proof" in " ".join(result.output.split())
    assert scenario.is_file()


def test_robots_that_touch_without_faults_are_named(eal: Any, write: Any, tmp_path: Path) -> None:
    """Their contacts under faults are no findings, so no proof of theirs is claimed."""
    mover = "plugins: {{sim: {{model: evbot2, start: {{x_m: {x_m}, y_m: 0, yaw_deg: {yaw_deg}}}}}}}"
    robots = {"ann": mover.format(x_m=-0.8, yaw_deg=0), "bob": mover.format(x_m=0.8, yaw_deg=180)}
    lines = "".join(f"  {name}: {{{text}}}\n" for name, text in robots.items())
    fleet = write("two.yaml", f"version: 1\nworld: empty\nrobots:\n{lines}")
    policy = "\ntimeout_s: 30\non_failure: skip\nsteps:"
    scenario = write("crash.yaml", scenario_of("send_cmd: {resource: Base, cmd: f1.5}").replace("\nsteps:", policy))
    options = ("--fault", "lost", "--runs", 1, "--jobs", 1, "--out", tmp_path / "out")
    result = eal("prove", scenario, "--fleet", fleet, *options)
    assert result.exit_code == 0, result.output
    assert "ann and bob touch without faults: their contacts are not judged" in result.stdout
    assert "ann and bob touch without faults" in (tmp_path / "out" / "proof.html").read_text()


@pytest.mark.slow
def test_the_page_links_each_finding_to_its_replay(eal: Any, tmp_path: Path) -> None:
    scenario, fleet = BUG.write(tmp_path)
    out = tmp_path / "out"
    result = eal(
        "prove", scenario, "--fleet", fleet, "--fault", "stuck-wheel", "--fault", "lost", "--out", out, "--json"
    )
    assert result.exit_code == 1, result.output
    found = json.loads(result.stdout)
    assert {finding["invariant"] for finding in found["findings"]} == {"contact"}
    page = (out / "proof.html").read_text()
    assert 'href="findings/1/run/report.html"' in page
    assert (out / "findings/1/run/report.html").is_file()
    least = out / "findings/1/least-fleet.yaml"
    again = eal("run", scenario, "--fleet", least, "--no-plot", "--runs-dir", tmp_path / "runs")
    assert again.exit_code == 1


@pytest.mark.slow
def test_pytest_takes_a_proof_as_a_test(pytester: pytest.Pytester) -> None:
    scenario, fleet = BUG.write(pytester.path)
    installed = {point.value for point in entry_points(group="pytest11")}
    named = [word for plugin in PLUGINS if plugin not in installed for word in ("-p", plugin)]
    options = ["-p", "no:cacheprovider", "-p", "no:hypothesispytest", *named, f"--eal-fleet={fleet}"]
    result = pytester.runpytest_subprocess(*options, "--eal", "--eal-prove", "--eal-prove-runs=20", scenario)
    result.assert_outcomes(passed=1, failed=1)  # the scenario, and its proof
    result.stdout.fnmatch_lines([f"*{scenario.name}:*: contact: ann touched bob *", "*least fleet: *least-fleet.yaml"])


@pytest.mark.slow
def test_every_run_repeats_to_the_bit_in_any_number_of_processes(eal: Any, tmp_path: Path) -> None:
    runs = []
    for jobs in (1, 2):
        out = tmp_path / f"out{jobs}"
        result = eal("prove", "dance", "--fleet", "sim", "--runs", 40, "--jobs", jobs, "--out", out, "--json")
        assert result.exit_code == 0, result.output
        runs.append(json.loads(result.stdout)["runs"])
    assert runs[0] == runs[1]
