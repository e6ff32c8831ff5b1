"""`eal report`, `eal diff` and `eal replay` of missing or broken runs: one message, exit code 2."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture
def run(eal: Any, slides: Path, move: Path) -> Path:
    """Return the folder of a run."""
    runs = slides.parent / "runs"
    assert eal("run", move, "--fleet", slides, "--rate", "max", "--runs-dir", runs, "--no-plot").exit_code == 0
    (folder,) = runs.iterdir()
    return Path(folder)


def told(result: Any) -> str:
    """Return the text of an error message without its frame."""
    assert result.exit_code == 2, result.output
    assert isinstance(result.exception, SystemExit)
    return "".join(result.stderr.replace("│", "").split())


def test_no_folder_and_no_run(eal: Any, tmp_path: Path, run: Path) -> None:
    nowhere = tmp_path / "nowhere"
    assert "thereisnosuchfolder" in told(eal("report", nowhere))
    assert "thereisnosuchfolder" in told(eal("diff", run, nowhere))
    assert "run.mcapcannotberead:Nosuchfileordirectory" in told(eal("replay", nowhere))
    assert "ithasnoevents.jsonl" in told(eal("report", tmp_path))


@pytest.mark.parametrize(
    ("file", "content", "commands"),
    [
        ("events.jsonl", b"5\n", ("report", "diff")),
        ("events.jsonl", b"{}\n", ("report", "diff")),
        ("events.jsonl", b'{"event": "log", "time_s": "x"}\n', ("report", "diff")),
        ("events.jsonl", b"\xff\xfe\n{}\n", ("report", "diff")),
        ("summary.json", b"null", ("report",)),
        ("trajectory.csv", b"\xff\xfe\n1\n", ("report", "diff")),
        ("run.mcap", b"no record", ("replay",)),
    ],
)
def test_a_file_that_makes_no_sense(
    eal: Any, run: Path, tmp_path: Path, file: str, content: bytes, commands: tuple[str, ...]
) -> None:
    broken = tmp_path / "broken"
    shutil.copytree(run, broken)
    (broken / file).write_bytes(content)
    for command in commands:
        arguments = (run, broken) if command == "diff" else (broken,)
        assert f"broken/{file}" in told(eal(command, *arguments))


DAMAGES = [
    ({"event": "log", "time_s": 1, "robot": None}, "log: text: is missing"),
    ({"event": "step_ended", "time_s": 1, "record": None}, "step_ended: record: must be a mapping"),
    (
        {"event": "robot_lost", "time_s": 1, "robot": "one", "error": {"code": "x"}},
        "robot_lost: error.message: is missing",
    ),
    ({"event": "run_started", "time_s": 0, "robots": 5}, "run_started: "),
    ({"event": "log", "time_s": math.inf, "robot": None, "text": "x"}, "it needs 'event' and 'time_s', a number"),
    ({"event": "log", "time_s": 10**400, "robot": None, "text": "x"}, "it needs 'event' and 'time_s', a number"),
    ({"event": ["log"], "time_s": 1}, "it needs 'event' and 'time_s', a number"),
]


@pytest.mark.parametrize(("event", "problem"), DAMAGES)
def test_an_event_that_was_changed_by_hand_is_named(eal: Any, run: Path, event: object, problem: str) -> None:
    """It ended with a traceback."""
    lines = (run / "events.jsonl").read_text(encoding="utf-8").splitlines()
    (run / "events.jsonl").write_text("\n".join([*lines[:2], json.dumps(event), *lines[3:], ""]), encoding="utf-8")
    for command in (("report", run), ("diff", run, run)):
        assert f"events.jsonl:3: is no event: {problem}".replace(" ", "") in told(eal(*command))


def test_events_of_other_releases_are_read(eal: Any, run: Path) -> None:
    with (run / "events.jsonl").open("a", encoding="utf-8") as events:
        events.write('{"event": "danced", "time_s": 9.0}\n')
    assert eal("report", run).exit_code == 0


def test_a_record_whose_bytes_were_changed(eal: Any, run: Path) -> None:
    """A record with any one byte changed is either refused or read."""
    record = run / "run.mcap"
    good = record.read_bytes()
    for place in range(40, len(good), max(1, len(good) // 60)):
        record.write_bytes(good[:place] + bytes([good[place] ^ 0x55]) + good[place + 1 :])
        result = eal("replay", run)
        assert result.exit_code in (0, 2), (place, result.exception)


def test_links_in_a_folder_of_a_stranger_lead_to_no_file_that_is_written(eal: Any, run: Path) -> None:
    """The page, the fleet file and the repaired record were written over the files to which the links led."""
    mine = run.parent / "mine.txt"
    mine.write_text("precious, without a last line end", encoding="utf-8")
    table = run.parent / "table.csv"
    table.write_text("robot,time_s,x_m,y_m,yaw_rad\nprecious", encoding="utf-8")
    for name in ("report.html", "replay.yaml", "run.mcap.tmp"):
        (run / name).symlink_to(mine)
    assert eal("report", run).exit_code == 0
    assert eal("replay", run, "--loop").exit_code == 0
    (run / "summary.json").unlink()
    (run / "trajectory.csv").symlink_to(table)
    (run / "run.mcap").write_bytes((run / "run.mcap").read_bytes()[:-400])
    said = eal("records", "repair", run)
    assert "repaired" in said.stdout, said.output
    assert table.read_text(encoding="utf-8").endswith("precious")
    assert mine.read_text(encoding="utf-8") == "precious, without a last line end"
    assert not (run / "report.html").is_symlink()
