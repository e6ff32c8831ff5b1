"""`eal report`, `eal diff` and `eal replay` of missing or broken runs: one message, exit code 2."""

from __future__ import annotations

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


def test_a_record_whose_bytes_were_changed(eal: Any, run: Path) -> None:
    """A record with any one byte changed is either refused or read."""
    record = run / "run.mcap"
    good = record.read_bytes()
    for place in range(40, len(good), max(1, len(good) // 60)):
        record.write_bytes(good[:place] + bytes([good[place] ^ 0x55]) + good[place + 1 :])
        result = eal("replay", run)
        assert result.exit_code in (0, 2), (place, result.exception)
