"""`eal sweep`: its table against single runs, kills and resumptions, failed runs, and invalid input."""

from __future__ import annotations

import csv
import fcntl
import json
import signal
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError
from eal_actors.lab.sweeping.variations import read_seeds, read_variations
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario, parse_scenario, run_scenario

Start = Callable[..., subprocess.Popen[str]]

FLEET = """\
    version: 1
    name: one
    seed: 3
    clock: {rate: max}
    python_steps: [falling:fall]
    robots:
      scout: {plugins: {sim: {model: roomba, start: {x_m: 0, y_m: 0}}}}
"""

SCENARIO = """\
    version: 1
    name: ways
    parameters:
      way_m: {type: double, unit: m, default: 0.2, minimum: 0.1, maximum: 2}
      back: {type: bool, default: false}
      speed_m_s: {type: double, default: 0.3, minimum: 0.05, maximum: 5}
      most_m: {type: double, default: 9}
    roles: {scouts: {}}
    steps:
      - let: {twice_m: 2 * way_m}
      - on: scouts
        do:
          - set_config: {resource: Base, key: speed_m_s, value: "${speed_m_s}"}
          - send_cmd: {resource: Base, cmd: "${('b' if back else 'f') + str(way_m)}"}
          - let: {off_m: "value('TruePose')[0]"}
          - expect: off_m < most_m
"""

FALLING = """\
    import os


    def fall(context, way_m):
        if way_m == 0.3:
            os._exit(7)
"""


def text_of(result: Any) -> str:
    """Return what a command has written to stderr, without frames and line breaks."""
    return " ".join(result.stderr.replace("│", " ").split())


@pytest.fixture
def fleet(write: Any) -> Path:
    write("falling.py", FALLING)
    file: Path = write("fleet.yaml", FLEET)
    return file


@pytest.fixture
def ways(write: Any) -> Path:
    file: Path = write("ways.yaml", SCENARIO.replace("${('b' if back else 'f') + str(way_m)}", "f${way_m}"))
    return file


def rows(out: Path) -> list[dict[str, str]]:
    with (out / "table.csv").open(encoding="utf-8", newline="") as table:
        return list(csv.DictReader(table))


def suite(out: Path) -> Xml.Element:
    found = Xml.parse(out / "junit.xml").find("testsuite")  # noqa: S314  # the sweep wrote it
    assert found is not None
    return found


def summaries(out: Path) -> dict[str, int]:
    """Return the finish time of each finished run."""
    return {file.parent.name: file.stat().st_mtime_ns for file in (out / "runs").glob("*/summary.json")}


@pytest.mark.slow
def test_the_table_says_of_every_run_what_a_run_by_itself_says(
    eal: Any, fleet: Path, ways: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    options = ["--vary", "way_m=0.2:0.4:0.2", "--vary", "back=false,true", "--seeds", "1:2", "--jobs", 2]
    result = eal("sweep", ways, "--fleet", fleet, *options, "--set", "most_m=0.3", "--out", out)
    assert result.exit_code == 1  # for 0.4 m are more than 0.3 m
    table = rows(out)
    assert list(table[0]) == [
        *("way_m", "back", "seed", "outcome", "duration_s", "expect steps[1].do[3]"),
        *("twice_m", "scout.off_m", "error", "run"),
    ]
    assert [(row["way_m"], row["back"], row["seed"]) for row in table] == [
        (way_m, back, seed) for way_m in ("0.2", "0.4") for back in ("false", "true") for seed in ("1", "2")
    ]
    config = EALConfigManager.load(fleet).fleet
    for row in table:
        way_m, seed = float(row["way_m"]), int(row["seed"])
        with Fleet(replace(config, seed=seed)) as opened:
            report = run_scenario(load_scenario(ways, {"way_m": way_m, "most_m": 0.3}), opened)
            x_m = float(opened["scout"]["TruePose"].get_value().get().value[0])
        assert float(row["duration_s"]) == report.duration_s
        assert float(row["twice_m"]) == 2 * way_m
        assert row["outcome"] == report.outcome == ("done" if way_m == 0.2 else "failed")
        assert row["expect steps[1].do[3]"] == ("passed" if way_m == 0.2 else "failed")
        assert ("expected off_m < most_m" in row["error"]) is (way_m == 0.4)
        assert (row["scout.off_m"], way_m) in ((repr(x_m), 0.2), ("", 0.4))  # an interrupted step leaves no file
        assert (out / "runs" / row["run"] / "events.jsonl").is_file()
    found = suite(out)
    assert (found.attrib["tests"], found.attrib["failures"], found.attrib["errors"]) == ("8", "4", "0")
    assert [case.attrib["name"] for case in found][:2] == [f"way_m=0.2 back=False seed={seed}" for seed in (1, 2)]
    assert (out / "table.png").read_bytes().startswith(b"\x89PNG")
    assert "ways on one, 8 runs: 4 of 8 runs failed" in result.stdout
    assert "1/8  " in result.stdout


OPTIONS = ("--vary", "way_m=0.2:0.7:0.1", "--seeds", "1:2", "--jobs", "2")


@pytest.mark.slow
def test_a_sweep_that_was_killed_goes_on_and_makes_the_same_table(
    start: Start, fleet: Path, ways: Path, tmp_path: Path
) -> None:
    killed = start("sweep", ways, "-f", fleet, *OPTIONS, "--out", "killed")
    assert killed.stdout is not None
    for line in killed.stdout:
        if line.startswith("1/12"):
            killed.kill()
            break
    rest = killed.communicate(timeout=60)[0]  # reaches its end only after the workers end, since they write to it too
    assert "12/12" not in rest
    finished = summaries(tmp_path / "killed")
    assert 1 <= len(finished) < 12
    cut_off = finished.popitem()[0]  # as if its last step had been running
    (tmp_path / "killed/runs" / cut_off / "summary.json").unlink()

    resumed = start("sweep", ways, "-f", fleet, *OPTIONS, "--out", "killed")
    out, err = resumed.communicate(timeout=100)
    assert (resumed.returncode, err) == (0, "")
    assert (" of 12 finished before" in out) is bool(finished)
    assert sum("  done after" in line for line in out.splitlines()) == 12 - len(finished)
    after = summaries(tmp_path / "killed")
    assert {name: after[name] for name in finished} == finished

    whole = start("sweep", ways, "-f", fleet, *OPTIONS, "--out", "whole")
    whole.communicate(timeout=100)
    assert whole.returncode == 0
    for file in ("table.csv", "junit.xml", "table.png"):
        assert (tmp_path / "killed" / file).read_bytes() == (tmp_path / "whole" / file).read_bytes()
    assert len(rows(tmp_path / "whole")) == 12


def test_ctrl_c_ends_it_at_once_and_says_how_it_goes_on(start: Start, fleet: Path, ways: Path, tmp_path: Path) -> None:
    process = start("sweep", ways, "-f", fleet, *OPTIONS, "--out", "out")
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "of 12 runs are finished; run the same command to resume." in err
    assert len(summaries(tmp_path / "out")) >= 1


def test_a_process_that_dies_costs_its_run_alone(eal: Any, fleet: Path, ways: Path, tmp_path: Path) -> None:
    ways.write_text(ways.read_text() + '  - python: "falling:fall"\n    with: {way_m: "${way_m}"}\n    timeout_s: 5\n')
    out = tmp_path / "out"
    result = eal("sweep", ways, "-f", fleet, "--vary", "way_m=0.2,0.3,0.4", "--jobs", 1, "--out", out)
    assert result.exit_code == 1
    assert [row["outcome"] for row in rows(out)] == ["done", "crashed", "done"]
    assert rows(out)[1]["error"] == "its process died with exit code 7"
    assert suite(out).attrib["errors"] == "1"


def test_a_run_that_the_robots_refuse_is_told_and_the_others_go_on(
    eal: Any, fleet: Path, ways: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    result = eal("sweep", ways, "-f", fleet, "--vary", "speed_m_s=0.2,2", "--jobs", 1, "--out", out, "--json")
    assert result.exit_code == 1
    content = json.loads(result.stdout)
    assert (content["failed"], [run["outcome"] for run in content["runs"]]) == (1, ["done", "refused"])
    assert content["runs"][0]["variables"]["twice_m"] == 0.4
    assert "ways.yaml:13:" in content["runs"][1]["error"]
    assert content["runs"][1]["run"] is None


def test_finished_runs_are_kept_for_the_same_files_only(eal: Any, fleet: Path, ways: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"

    def sweep(*options: object) -> Any:
        return eal("sweep", ways, "-f", fleet, "--vary", "way_m=0.2,0.3", "--jobs", 1, "--out", out, *options)

    assert sweep().exit_code == 0
    first = summaries(out)
    assert sweep().exit_code == 0
    assert summaries(out) == first
    wider = eal("sweep", ways, "-f", fleet, "--vary", "way_m=0.2:0.4:0.1", "--jobs", 1, "--out", out)
    assert wider.exit_code == 0
    assert first.items() < summaries(out).items()  # finished runs count for a wider sweep

    ways.write_text(ways.read_text().replace("off_m < most_m", "off_m <= most_m"))
    changed = sweep()
    assert changed.exit_code == 2
    assert f"{ways} has changed since the runs in {out}: run all of them again with --repeat" in text_of(changed)
    assert sweep("--repeat").exit_code == 0
    assert set(summaries(out)) == set(first)
    assert not set(summaries(out).items()) & set(first.items())

    steps = fleet.parent / "falling.py"
    former = steps.read_text()
    steps.write_text(f"{former}# changed")
    changed = sweep()
    assert changed.exit_code == 2
    assert f"{fleet} (or its world, its map, its Python steps, or this release) has changed" in text_of(changed)
    steps.write_text(former)

    with (out / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        assert "another sweep uses" in text_of(sweep())
    (out / "sweep.json").unlink()
    refused = sweep()
    assert refused.exit_code == 2
    assert "is not the folder of a sweep" in text_of(refused)


def test_a_table_that_cannot_be_written_is_wrong_input(eal: Any, fleet: Path, ways: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert eal("sweep", ways, "-f", fleet, "--out", out).exit_code == 0
    (out / "table.csv").unlink()
    (out / "table.csv").mkdir()
    result = eal("sweep", ways, "-f", fleet, "--out", out)
    assert result.exit_code == 2, result.exception
    assert f"{out}: cannot be written: Is a directory" in text_of(result)


def test_a_folder_that_cannot_be_written_is_wrong_input(eal: Any, fleet: Path, ways: Path) -> None:
    result = eal("sweep", ways, "-f", fleet, "--out", fleet / "out")  # below a file
    assert result.exit_code == 2
    assert f"{fleet / 'out'}: cannot be written: Not a directory" in text_of(result)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["--vary", "wey_m=1,2"],
            "{ways}:3:1: parameters: there is no parameter 'wey_m' to vary; did you mean 'way_m'?",
        ),
        (
            ["--vary", "way_m=1:3:1"],
            "{ways}:4:3: parameters.way_m: must be double 0.1..2 m, not 3.0; --vary sets",
        ),
        (["--vary", "back=1,true"], "{ways}:5:3: parameters.back: must be bool, not '1'; --vary sets it"),
        (["--vary", "way_m"], "must be NAME=FROM:TO:STEP or NAME=VALUE,VALUE, not 'way_m'"),
        (["--vary", "way_m=1:2"], "'way_m' must be FROM:TO:STEP in numbers, not '1:2'"),
        (["--vary", "way_m=2:1:0.1"], "'way_m' must go up from FROM to TO by a STEP over 0"),
        (["--vary", "way_m=1,1"], "gives the value of 'way_m' 1.0 twice"),
        (["--vary", "way_m=1", "--vary", "way_m=2"], "varies 'way_m' twice"),
        (["--vary", "way_m=0.1:2:0.0001"], "'way_m' has 19001 values, more than 1000 runs; --limit allows more"),
        (["--vary", "way_m=0.1:2:0.1", "--seeds", "1:100"], "20 values of way_m times 100 seeds make 2000 runs, more"),
        (["--seeds", "3:1"], "must be seeds such as 1:20 or 1,5,9"),
        (["--seeds", "1,1"], "gives the seed 1 twice"),
    ],
)
def test_what_cannot_be_swept_is_refused_before_anything_runs(
    eal: Any, fleet: Path, ways: Path, tmp_path: Path, options: list[str], message: str
) -> None:
    result = eal("sweep", ways, "-f", fleet, *options, "--out", tmp_path / "out")
    assert result.exit_code == 2
    assert message.format(ways=ways) in text_of(result)
    assert not (tmp_path / "out").exists()


def test_ranges_hold_both_ends_and_no_rounding() -> None:
    head = "version: 1\nname: t\nparameters:\n"
    kinds = {"x": "double", "n": "int", "w": "string", "l": "list"}
    declared = "".join(f"  {name}: {{type: {kind}}}\n" for name, kind in kinds.items())
    scenario = parse_scenario(f"{head}{declared}roles: {{all: {{}}}}\nsteps: [{{log: ''}}]\n".replace("''", "hi"), "t")

    def values(text: str) -> tuple[Any, ...]:
        (variation,) = read_variations(scenario, [text], 100)
        return variation.values

    assert values("x=0.1:0.5:0.1") == (0.1, 0.2, 0.3, 0.4, 0.5)
    assert values("x=1:1.5:0.3") == (1.0, 1.3)
    assert values("x=1,2.5") == (1.0, 2.5)
    assert values("n=2:4") == (2, 3, 4)
    assert values("n=0:10:5") == (0, 5, 10)
    assert values("w=red,a:b") == ("red", "a:b")
    assert values("l=[[1, 2], []]") == ((1, 2), ())
    assert read_seeds("1:3,9", 10) == (1, 2, 3, 9)
    with pytest.raises(ConfigError, match="must be int"):
        values("n=one")
    for wrong in ("n=1:2:0.5", "l=1,2", "x=0:inf:1", "x=1:2:3:4", "x=0:1:0"):
        with pytest.raises(ValueError, match=wrong[0]):
            values(wrong)
