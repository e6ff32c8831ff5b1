"""`eal record`: the folder is that of a run, for every command that reads one."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from tests.cli.conftest import Program
from tests.net.links import eventually
from tests.program import eal_processes, paused_terminal


@pytest.mark.parametrize("extent", ["poses", pytest.param("all", marks=pytest.mark.slow)])
def test_the_record_is_one_of_a_run(eal: Program, tmp_path: Path, extent: str) -> None:
    said = eal(
        *("record", "--fleet", "sim", "roomba-1", "--duration-s", 0.3, "--record", extent, "--runs-dir", tmp_path)
    )
    assert said.exit_code == 0, said.output
    (run,) = tmp_path.iterdir()
    lines = said.stdout.splitlines()
    assert lines[0] == f"recording 1 robot to {run}: for 0.3 s"
    assert lines[-1] == f"next: eal replay {run}"
    files = {file.name for file in run.iterdir()}
    assert files >= {"events.jsonl", "summary.json", "trajectory.csv", "trajectory.png", "run.mcap"}
    for command in ("report", "replay"):
        assert eal(command, run).exit_code == 0
    options = ("--fleet", run / "replay.yaml", "--rate", "max", "--no-plot", "--json", "--runs-dir", tmp_path)
    summary = json.loads(eal("run", run / "scenario.yaml", *options).stdout)
    assert (summary["outcome"], list(summary["robots"])) == ("done", ["roomba-1"])


def test_a_robot_that_is_not_in_the_fleet_is_refused_before_anything_is_written(eal: Program, tmp_path: Path) -> None:
    said = eal("record", "--fleet", "sim", "romba-1", "--runs-dir", tmp_path)
    assert said.exit_code == 2
    assert "did you mean 'roomba-1'?" in said.output
    assert list(tmp_path.iterdir()) == []


def test_it_ends_at_sigterm_while_its_terminal_is_paused(tmp_path: Path) -> None:
    """Its output blocked it."""
    with paused_terminal() as terminal, eal_processes(tmp_path) as start:
        arguments = "record", "--fleet", "sim", "roomba-1", "--record", "poses", "--runs-dir", tmp_path
        recorder = start(*arguments, environment=os.environ, stdout=terminal)
        assert eventually(lambda: any(file.stat().st_size > 1000 for file in tmp_path.glob("*/trajectory.csv")))
        recorder.terminate()
        assert recorder.wait(30.0) == 0
        assert list(tmp_path.glob("*/summary.json"))
