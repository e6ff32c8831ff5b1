"""Comparison of two runs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.errors import ScenarioError
from eal_actors.recording import Difference, RunFolder, compare_runs


@pytest.fixture
def other(run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(run, tmp_path / "other"))


def change_event(run: Path, number: int, change: dict[str, Any]) -> None:
    lines = (run / "events.jsonl").read_text().splitlines()
    lines[number] = json.dumps({**json.loads(lines[number]), **change})
    (run / "events.jsonl").write_text("\n".join(lines) + "\n")


def compared(run: Path, other: Path, tolerance: float = 0.0) -> list[Difference]:
    return list(compare_runs(RunFolder.open(run), RunFolder.open(other), tolerance))


def test_a_changed_event_is_named_with_both_values(run: Path, other: Path) -> None:
    change_event(other, 0, {"scenario": "square"})
    assert compared(run, other) == [Difference("events[0].scenario", "'round'", "'square'")]


def test_wall_times_and_hosts_may_differ(run: Path, other: Path) -> None:
    change_event(other, 0, {"wall_time": "now", "host_name": "there"})
    assert compared(run, other) == []


def test_numbers_within_the_tolerance_count_as_equal(run: Path, other: Path) -> None:
    time_s = json.loads((run / "events.jsonl").read_text().splitlines()[-1])["time_s"]
    change_event(other, -1, {"time_s": time_s + 0.001})
    assert len(compared(run, other)) == 1
    assert compared(run, other, tolerance=0.01) == []


def test_the_first_difference_of_a_path_is_reported(run: Path, other: Path) -> None:
    table = other / "trajectory.csv"
    lines = table.read_text().splitlines()
    robot, time_s, x_m, *rest = lines[5].split(",")
    lines[5] = ",".join([robot, time_s, str(float(x_m) + 1), *rest])
    table.write_text("\n".join(lines) + "\n")
    (found,) = compared(run, other)
    assert found.where == f"{robot} at {float(time_s):.3f} s"


def test_poses_that_differ_only_in_their_time_are_shown_with_it(run: Path, other: Path) -> None:
    """Both sides showed the same pose."""
    table = other / "trajectory.csv"
    lines = table.read_text().splitlines()
    robot, time_s, *rest = lines[5].split(",")
    later = str(float(time_s) + 0.01)
    lines[5] = ",".join([robot, later, *rest])
    table.write_text("\n".join(lines) + "\n")
    (found,) = compared(run, other)
    assert found.left != found.right
    assert repr(float(time_s)) in found.left
    assert repr(float(later)) in found.right


def test_saved_files_are_compared(run: Path, other: Path) -> None:
    (other / "roomba-1" / "frame.png").write_bytes(b"black")
    (other / "evbot3-1" / "frame.png").unlink()
    assert [found.where for found in compared(run, other)] == ["evbot3-1/frame.png", "roomba-1/frame.png"]


def test_a_last_line_torn_by_a_crash_is_ignored_but_a_broken_line_is_not(run: Path, other: Path) -> None:
    text = (other / "events.jsonl").read_text()
    (other / "events.jsonl").write_text(text[:-20])
    assert len(RunFolder.open(other).events) == len(RunFolder.open(run).events) - 1
    (other / "events.jsonl").write_text("{broken\n" + text)
    with pytest.raises(ScenarioError, match=r"events\.jsonl:1: is no event"):
        compared(run, other)


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"it has no events\.jsonl"):
        RunFolder.open(tmp_path)
