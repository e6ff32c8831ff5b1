"""The errors and counts that `eal run` prints at its end."""

import re
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from tests.scenario_texts import BOMB

HEAD = "version: 1\nname: trial\nroles: {all: {robots: [roomba-1, evbot3-1]}}\n"
ZERO = "(value('Pose')[0] * 0)"
"""Known during the run only."""


def lines_of(eal: Any, folder: Path, fleet: str, text: str) -> list[str]:
    """Run a scenario as fast as it goes, and return the printed lines."""
    file = folder / "trial.yaml"
    file.write_text(HEAD + text, encoding="utf-8")
    runs = folder / "runs"
    result = eal("run", file, "--fleet", bundled_path(fleet), "--runs-dir", runs, "--rate", "max", "--no-plot")
    return list(result.stdout.splitlines())


@pytest.mark.parametrize(
    ("body", "place", "reason"),
    [
        (f'steps:\n- on: all\n  do:\n  - let: {{x: "1 / {ZERO}"}}\n', "7:5", "a division by zero"),
        (f'steps:\n- on: all\n  do:\n  - expect: "{ZERO} == 2"\n', "7:5", "expected"),
        (f'steps:\n- on: all\n  do:\n  - while: "{ZERO} == 0"\n    limit: 2\n    do: [log: x]\n', "7:12", "the limit"),
        (f'on_failure: drop\nsteps:\n- on: all\n  do:\n  - let: {{x: "1 / {ZERO}"}}\n', "8:5", "division"),
        (BOMB, "8:3", "more than 100000 items"),
    ],
)
def test_an_error_of_the_scenario_has_its_place_once(
    body: str, place: str, reason: str, eal: Any, tmp_path: Path
) -> None:
    """Only the errors of budgets had one."""
    lines = lines_of(eal, tmp_path, "fleets/sim.yaml", body)
    found = [re.findall(r"trial\.yaml:(\d+:\d+): ", line) for line in lines if reason in line and "trial.yaml" in line]
    assert found
    assert all(places == [place] for places in found)


def test_an_error_inside_a_repeated_block_has_the_place_of_its_step(eal: Any, tmp_path: Path) -> None:
    body = (
        f'steps:\n- on: all\n  do:\n  - repeat: 2\n    on_failure: {{retry: 1}}\n    do: [let: {{x: "1 / {ZERO}"}}]\n'
    )
    lines = lines_of(eal, tmp_path, "fleets/sim.yaml", body)
    assert any("trial.yaml:9:10: " in line and "division by zero" in line for line in lines)
    assert not any(line.count("trial.yaml:") > 1 for line in lines)


def test_an_error_of_a_robot_has_no_place_in_the_file(eal: Any, tmp_path: Path) -> None:
    body = "timeout_s: 1\nsteps:\n- on: all\n  do:\n  - send_cmd: {resource: Base, cmd: f1}\n"
    lines = lines_of(eal, tmp_path, "fleets/sim.yaml", body)
    assert any("failed" in line and "Base" in line for line in lines)
    assert not any("trial.yaml:" in line for line in lines)


def test_the_table_of_robots_counts_formations(eal: Any, tmp_path: Path) -> None:
    """They were not counted."""
    passes = "- repeat: 16\n  do: [{on: all, do: [get_value: {resource: Pose}]}]\n"
    body = f"steps:\n- formation: {{role: all, shape: line, spacing_m: 1.0, at: [0, 1]}}\n{passes}"
    lines = lines_of(eal, tmp_path, "fleets/sim.yaml", body)
    rows = [line.split() for line in lines if line.startswith(("roomba-1 ", "evbot3-1 "))]
    assert sorted(row[:3] for row in rows) == [["evbot3-1", "done", "17"], ["roomba-1", "done", "17"]]
    assert any("2 robots, 34 calls" in line for line in lines)
