"""A controller killed while its robots drive, and the record of the resumed run."""

from __future__ import annotations

import csv
import io
import json
import signal
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from eal_actors.cli.options import GlobalOptions
from eal_actors.cli.progress import LiveProgress
from eal_actors.kernel.bundled import bundled_path
from eal_actors.recording import RunFolder
from eal_actors.recording.mcap_file import McapContent, read_mcap
from eal_actors.scenario import Report, RunContinued, StepStarted
from tests.manual_clock import ManualClock

SCENARIO = """\
version: 1
name: legs
description: Drive, and drive again.
roles: {drivers: {robots: [roomba-1, evbot3-1]}}
safe_to_repeat: true
steps:
  - on: drivers
    do: [{send_cmd: {resource: Base, cmd: f0.2}}]
  - on: drivers
    do: [{send_cmd: {resource: Base, cmd: f0.3}}, {send_cmd: {resource: Base, cmd: r90}}]
"""


def rows_of(run: Path) -> list[dict[str, str]]:
    with (run / "trajectory.csv").open(encoding="utf-8", newline="") as table:
        return list(csv.DictReader(table))


@pytest.fixture
def killed(start: Any, write: Any, tmp_path: Path) -> Path:
    """The folder of a run whose controller was killed in its second step."""
    scenario = write("legs.yaml", SCENARIO)
    words = ("--rate", "5", "--runs-dir", tmp_path / "runs", "--events", "-")
    process = start("run", scenario, "-f", bundled_path("fleets/sim.yaml"), *words)
    assert process.stdout is not None
    for line in process.stdout:
        event = json.loads(line)
        if event["event"] == "step_started" and (event["robot"], event["label"]) == ("roomba-1", "send_cmd Base r90"):
            break
    process.send_signal(signal.SIGKILL)
    process.communicate()
    (run,) = (tmp_path / "runs").iterdir()
    return run


def test_nothing_is_lost_from_the_record_of_a_run_that_goes_on(eal: Any, killed: Path) -> None:
    before = (killed / "trajectory.csv").read_text(encoding="utf-8").rpartition("\n")[0]
    events_before = RunFolder.open(killed).events
    assert not (killed / "summary.json").exists()
    assert len(before.splitlines()) > 20, "the paths are written while the robots go"

    result = eal("run", "--resume", killed, "--rate", "max")
    assert result.exit_code == 0, result.output

    run = RunFolder.open(killed)
    assert run.summary is not None
    (break_s,) = run.breaks_s
    assert run.summary.continued_s == (break_s,)
    assert run.events[: len(events_before)] == events_before
    check_cut_off(run.summary, events_before)
    times_s = [event["time_s"] for event in run.events]
    assert times_s == sorted(times_s)
    assert (killed / "trajectory.csv").read_text(encoding="utf-8").startswith(before)
    for robot in ("roomba-1", "evbot3-1"):
        path_s = [float(row["time_s"]) for row in rows_of(killed) if row["robot"] == robot]
        assert path_s == sorted(set(path_s)), "the time of the record never goes back"
        assert path_s[0] < 1.0
        assert min(time_s for time_s in path_s if time_s >= break_s - 0.0005) == pytest.approx(break_s, abs=0.001)
        assert path_s[-1] == pytest.approx(run.summary.duration_s, abs=0.2)
    assert not list(killed.glob("run-*")) + list(killed.glob("*.tmp"))
    assert (killed / "continued-1" / "versions.json").is_file()
    check_whole(run.record, run, break_s)


def check_cut_off(summary: Report, events_before: Sequence[Mapping[str, Any]]) -> None:
    """The summary includes the steps that were running at the kill."""
    started = {(event["robot"], event["step"]) for event in events_before if event["event"] == "step_started"}
    ended = {(event["record"]["robot"], event["record"]["step"]) for event in events_before if "record" in event}
    cut_off = {(step.robot, step.step): step for step in summary.steps if step.outcome == "aborted"}
    assert set(cut_off) == started - ended
    (turn,) = (step for step in cut_off.values() if step.robot == "roomba-1")
    assert (turn.resource, turn.command, turn.end_s) == ("Base", "r90", events_before[-1]["time_s"])
    assert turn.error is not None
    assert "controller died" in turn.error.message


def check_whole(record: McapContent, run: RunFolder, break_s: float) -> None:
    """The MCAP record contains every event, pose and call, from before and after the kill."""
    assert record.is_complete
    events = [entry.message for entry in record.messages if entry.topic == "/events"]
    assert [{key: event[key] for key in event if key != "timestamp"} for event in events] == list(run.events)
    for robot, path in run.paths.items():
        poses = [entry for entry in record.messages if entry.topic == f"/{robot}/TruePose"]
        wanted = [(sample.time_s, sample.x_m, sample.y_m) for sample in path]
        found = [(pose.time_s, *(pose.message["pose"]["position"][key] for key in "xy")) for pose in poses]
        assert len(found) == len(wanted)
        for one, other in zip(found, wanted, strict=True):
            assert one == pytest.approx(other, abs=0.0006)
    calls = [entry.message["command"] for entry in record.messages if entry.topic == "/roomba-1/commands"]
    assert calls == ["f0.2", "f0.3", "f0.3", "r90"]
    (line,) = [
        entry for entry in record.messages if entry.topic == "/log" and "interrupted" in entry.message["message"]
    ]
    assert line.time_s == pytest.approx(break_s)
    assert len([entry for entry in record.messages if entry.topic == "/arena"]) <= 1
    assert "resources.json" in record.attachments


@pytest.mark.slow
def test_a_run_that_was_cut_off_twice(eal: Any, killed: Path) -> None:
    torn = (killed / "run.mcap").read_bytes()
    assert eal("run", "--resume", killed, "--rate", "max").exit_code == 0
    (first,) = RunFolder.open(killed).breaks_s
    (killed / "run.mcap").rename(killed / "run-2.mcap")  # as if the second controller had died before it joined them
    (killed / "run.mcap").write_bytes(torn)
    (killed / "run-2.mcap").write_bytes((killed / "run-2.mcap").read_bytes()[:4000])
    (killed / "summary.json").unlink()
    lines = (killed / "events.jsonl").read_text(encoding="utf-8").splitlines()
    number = next(number for number, line in enumerate(lines) if '"run_continued"' in line)
    (killed / "events.jsonl").write_text("\n".join([*lines[: number + 2], '{"event": "st']), encoding="utf-8")

    assert eal("run", "--resume", killed, "--rate", "max").exit_code == 0
    run = RunFolder.open(killed)
    assert run.summary is not None
    assert len(run.breaks_s) == 2
    assert run.breaks_s[0] == first
    assert run.summary.continued_s == run.breaks_s
    content = read_mcap(killed / "run.mcap")
    assert content.is_complete
    assert len([entry for entry in content.messages if entry.topic == "/events"]) >= len(run.events)


def test_the_report_shows_the_break(eal: Any, killed: Path) -> None:
    assert eal("run", "--resume", killed, "--rate", "max").exit_code == 0
    assert eal("report", killed).exit_code == 0
    page = (killed / "report.html").read_text(encoding="utf-8")
    (break_s,) = RunFolder.open(killed).breaks_s
    assert f"resumed at {break_s:.3f} s" in page
    assert "the run was interrupted here, and resumed at steps[1]" in page
    assert 'class="tick break"' in page


def test_the_live_table_knows_the_robots_of_a_run_that_goes_on() -> None:
    out = io.StringIO()
    progress = LiveProgress(Console(file=out, force_terminal=True, width=120), ManualClock(), GlobalOptions())
    with progress:
        progress.on_event(RunContinued(30.0, 1, "", "legs", "sim", ("roomba-1", "evbot3-1"), 4))
        progress.on_event(StepStarted(30.0, "roomba-1", "steps[1].do[0]", "send_cmd Base f0.3"))
    assert "continued at steps[1]" in out.getvalue()
    assert "legs on sim" in out.getvalue()
    assert "send_cmd Base f0.3" in out.getvalue()
