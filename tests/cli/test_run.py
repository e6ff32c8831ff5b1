"""`eal run`, in this process."""

import csv
import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from typer.testing import Result

from eal_actors.kernel.bundled import bundled_path
from eal_actors.scenario import summary_schema


def the_run(runs: Path) -> Path:
    (directory,) = runs.iterdir()
    return directory


def test_a_run_shows_each_event_and_each_call_and_says_where_its_folder_is(
    eal: Any, slides: Path, move: Path, tmp_path: Path
) -> None:
    result = eal("run", move, "--fleet", slides, "--runs-dir", tmp_path / "runs", "--rate", 10)
    assert result.exit_code == 0
    assert result.stderr == ""
    lines = result.stdout.splitlines()
    assert re.fullmatch(r" +\d\.\d\d s  move on slides: 2 robots \(one, two\)", lines[0])
    for robot in ("one", "two"):
        assert (
            sum(re.fullmatch(rf" +\d\.\d\d s  {robot}  send_cmd Slide to0.02", line) is not None for line in lines) == 1
        )
        assert sum(f"{robot}  get_value Slide  done after" in line for line in lines) == 1
        rows = [line.split() for line in lines if line.startswith(f"{robot} ")]
        assert [row[1:5] for row in rows] == [
            ["send_cmd", "Slide", "to0.02", "done"],
            ["get_value", "Slide", "done", rows[1][4]],
        ]
    directory = the_run(tmp_path / "runs")
    assert re.match(r"move on slides: done, 2 robots, 4 calls, \d", lines[-2])
    assert lines[-1] == f"run: {directory}"


def test_the_folder_has_the_scenario_s_name_and_the_time_and_holds_the_summary(
    eal: Any, slides: Path, move: Path, tmp_path: Path
) -> None:
    before = datetime.now(UTC).replace(microsecond=0)
    eal("run", move, "--fleet", slides, "--runs-dir", tmp_path / "runs", "--rate", 10, "--seed", 5)
    directory = the_run(tmp_path / "runs")
    stamp = datetime.strptime(directory.name, "move-%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
    assert before <= stamp <= datetime.now(UTC)
    summary = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    jsonschema.validate(summary, summary_schema())
    assert (summary["outcome"], summary["seed"], summary["rate"]) == ("done", 5, 10.0)
    assert not (directory / "trajectory.csv").exists()  # a slide has no Pose


def test_two_runs_never_share_a_folder(eal: Any, slides: Path, move: Path, tmp_path: Path) -> None:
    for _ in range(3):
        assert eal("run", move, "--fleet", slides, "--runs-dir", tmp_path / "runs", "--rate", 50).exit_code == 0
    assert len(list((tmp_path / "runs").iterdir())) == 3


def test_with_json_stdout_is_the_summary_and_nothing_else(eal: Any, slides: Path, move: Path, tmp_path: Path) -> None:
    result = eal("run", move, "--fleet", slides, "--runs-dir", tmp_path / "runs", "--rate", 10, "--json")
    kept = (the_run(tmp_path / "runs") / "summary.json").read_text(encoding="utf-8")
    assert json.loads(result.stdout) == json.loads(kept)
    assert "one  send_cmd Slide to0.02" in result.stderr


@pytest.mark.parametrize("plot", [True, False])
def test_paths_are_kept_as_a_table_and_a_picture(eal: Any, tmp_path: Path, plot: bool) -> None:
    fleet, scenario = bundled_path("fleets/sim.yaml"), bundled_path("scenarios/dance.yaml")
    options = [] if plot else ["--no-plot"]
    result = eal("run", scenario, "--fleet", fleet, "--runs-dir", tmp_path / "runs", "--rate", 20, *options)
    assert result.exit_code == 0
    directory = the_run(tmp_path / "runs")
    with (directory / "trajectory.csv").open(encoding="utf-8", newline="") as table:
        robots = {row["robot"] for row in csv.DictReader(table)}
    assert robots == {"evbot2-1", "evbot3-1", "roomba-1"}
    assert (directory / "trajectory.png").exists() == plot
    assert (f"png: {directory / 'trajectory.png'}" in result.stdout) == plot


def test_the_problems_of_both_files_are_told_at_once(eal: Any, write: Any, tmp_path: Path) -> None:
    scenario = write("s.yaml", "version: 1\nname: s\ndescription: d\nroles: {a: {}}\nsteps: [{dance: 1}]\n")
    broken = write("f1.yaml", "version: 1\nrobots: {a: {tags: 5, plugins: {sample: {}}}}\n")
    refused = write("f2.yaml", "version: 1\nrobots: {a: {plugins: {sample: {nix: 1}}}}\n")
    for fleet in (broken, refused):
        result = eal("run", scenario, "--fleet", fleet, "--runs-dir", tmp_path / "runs")
        assert result.exit_code == 2
        problems = [line for line in result.stderr.splitlines()[:-2] if not line.startswith("    ")]
        assert [line.split(":")[0] for line in problems] == [str(fleet), str(scenario)]
    assert not (tmp_path / "runs").exists()


def test_what_the_fleet_cannot_do_is_told_before_anything_moves(
    eal: Any, slides: Path, write: Any, move: Path, tmp_path: Path
) -> None:
    scenario = write("move.yaml", move.read_text(encoding="utf-8").replace("to0.02", "to2"))
    result = eal("run", scenario, "--fleet", slides, "--runs-dir", tmp_path / "runs")
    assert result.exit_code == 2
    assert f"{scenario}:8:" in result.stderr
    assert not (tmp_path / "runs").exists()


def test_a_robot_that_did_not_connect_is_unreachable(eal: Any, half_dead: Path, move: Path, tmp_path: Path) -> None:
    result = eal("run", move, "--fleet", half_dead, "--runs-dir", tmp_path / "runs")
    assert result.exit_code == 3
    assert "Error: lost: " in result.stderr
    assert "plugin 'dead': connect raised OSError: no such port" in result.stderr
    assert not (tmp_path / "runs").exists()


def test_a_robot_that_lacks_what_is_needed_because_a_plugin_did_not_connect_is_unreachable(
    eal: Any, half_dead: Path, move: Path, tmp_path: Path
) -> None:
    text = half_dead.read_text(encoding="utf-8").replace("{dead: {}}", "{dead: {}, sample: {}}")
    half_dead.write_text(text, encoding="utf-8")
    result = eal("run", move, "--fleet", half_dead, "--runs-dir", tmp_path / "runs")
    assert result.exit_code == 3
    assert "Error: lost: plugin 'dead': connect raised OSError: no such port. So the scenario" in result.stderr
    assert f"{move}:8:" in result.stderr


def run_changed(eal: Any, scenario: Path, fleet: Path, old: str, new: str) -> Result:
    """Replace a text of a scenario and run it ten times as fast."""
    scenario.write_text(scenario.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    result: Result = eal("run", scenario, "--fleet", fleet, "--runs-dir", scenario.parent / "runs", "--rate", 10)
    return result


def test_a_robot_that_the_scenario_does_not_need_may_be_lost(eal: Any, half_dead: Path, move: Path) -> None:
    assert run_changed(eal, move, half_dead, "movers: {}", "movers: {tags: [wide]}").exit_code == 0


def test_a_failed_run_reports_every_failure_in_full(eal: Any, slides: Path, move: Path) -> None:
    result = run_changed(eal, move, slides, "to0.02}", "to1}\n        timeout_s: 0.5")
    assert result.exit_code == 1
    assert "one  send_cmd Slide to1  failed: one/Slide: send_cmd 'to1' had no answer within its 0.5 s" in result.stdout
    assert "move on slides: failed" in result.stdout


def test_a_long_run_is_summed_up_by_robot(eal: Any, write: Any, tmp_path: Path) -> None:
    fleet = write("many.yaml", "version: 1\nrobots:\n  bot{n}: {count: 40, plugins: {sample: {}}}\n")
    scenario = write(
        "count.yaml",
        """\
        version: 1
        name: count
        description: Count.
        roles: {all: {}}
        steps:
          - on: all
            do: [{repeat: 3, do: [{set_value: {resource: SampleResource, value: "${i}"}}]}]
        """,
    )
    result = eal("run", scenario, "--fleet", fleet, "--runs-dir", tmp_path / "runs")
    assert result.exit_code == 0
    table = result.stdout[result.stdout.index("\nrobot ") :].splitlines()
    assert [line.split()[:4] for line in table if "40 robots" in line] == [
        ["40", "robots", "done", "120"],
        ["count", "on", "many:", "done,"],
    ]
    assert len(table) < 10


def test_a_folder_that_cannot_be_made_is_bad_input(eal: Any, slides: Path, move: Path, write: Any) -> None:
    result = eal("run", move, "--fleet", slides, "--runs-dir", write("a_file", ""))
    assert result.exit_code == 2
    assert "cannot be made: Not a directory" in result.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_run_goes_on_where_its_stream_of_events_cannot_be_written(
    eal: Any, slides: Path, move: Path, tmp_path: Path
) -> None:
    runs = tmp_path / "runs"
    result = eal("run", move, "--fleet", slides, "--runs-dir", runs, "--rate", 10, "--events", "/dev/full")
    assert result.exit_code == 0
    assert "no further events are written" in result.stderr
    assert json.loads((the_run(runs) / "summary.json").read_text(encoding="utf-8"))["outcome"] == "done"


def test_the_scenarios_that_a_scenario_carries_out_are_kept_with_it(eal: Any, slides: Path, write: Any) -> None:
    write("parts/inner.yaml", "version: 1\nname: inner\nroles: {all: {}}\nsteps: [{log: inside}]\n")
    outer = "version: 1\nname: outer\nroles: {all: {}}\nsteps:\n  - scenario: ../parts/inner.yaml\n"
    scenario = write("mine/outer.yaml", outer)
    runs = slides.parent / "runs"
    assert eal("run", scenario, "--fleet", slides, "--runs-dir", runs, "--rate", 10).exit_code == 0
    kept = the_run(runs)
    assert (kept / "scenario.yaml").read_text(encoding="utf-8") == outer
    assert (kept / "scenarios" / "mine" / "outer.yaml").read_text(encoding="utf-8") == outer
    assert eal("check", kept / "scenarios" / "mine" / "outer.yaml").exit_code == 0
