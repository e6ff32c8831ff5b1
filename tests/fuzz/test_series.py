"""The long series of motions goes on where it was ended, and counts only what the present code did."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from tests.fuzz.drivers import DRIVERS
from tests.fuzz.series import Chunk, code_of, main, missing, read, table_of

NAME = "evbot2-cable"


def chunk(seed: int) -> Chunk:
    return Chunk(NAME, code_of(DRIVERS[NAME]), seed, {"ok": 8, "not_ready": 2}, 30, 0.012, 0.5, [])


def kept(path: Path, *chunks: Chunk) -> Path:
    path.write_text("".join(json.dumps(asdict(chunk)) + "\n" for chunk in chunks))
    return path


def test_only_the_missing_chunks_are_run(tmp_path: Path) -> None:
    chunks = read(kept(tmp_path / "kept.jsonl", chunk(5)))
    assert missing(chunks, [NAME], 30, 4, 10) == [(NAME, 4), (NAME, 6)]


def test_what_other_code_did_does_not_count(tmp_path: Path) -> None:
    others = replace(chunk(5), code="0" * 16), replace(chunk(5), driver="gone")
    assert read(kept(tmp_path / "kept.jsonl", *others)) == []
    assert code_of(DRIVERS[NAME]) != code_of(DRIVERS["evbot3-stream"])


def test_the_table_sums_a_driver_up() -> None:
    wrong = replace(chunk(6), wrong=["seed 6: it moves on"], worst_m=0.06)
    assert table_of([chunk(5), wrong]) == (
        "evbot2-cable: 20 motions, 60 faults: ok 16, not_ready 4; worst ok 6.0 cm 0.5 deg; wrong: 1"
    )


@pytest.mark.slow
def test_a_series_goes_on_and_a_wrong_motion_fails_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "kept.jsonl"
    arguments = [NAME, "roomba-oi-cable", "--motions", "20", "--size", "10", "--processes", "1", "--out", str(out)]
    assert main(arguments) == 0
    assert "4 are to be run" in capsys.readouterr().out
    lines = out.read_text().splitlines()
    out.write_text("\n".join(lines[1:]) + "\n")
    assert main(arguments) == 0
    assert "3 chunks are kept" in (shown := capsys.readouterr().out)
    assert "1 are to be run" in shown
    assert sorted(out.read_text().splitlines()) == sorted(lines)
    kept(out, *(replace(chunk, wrong=["seed 1: it moves on"]) for chunk in read(out)))
    assert main(arguments) == 1
