"""Progress of long work, and what Ctrl-C leaves of it."""

from __future__ import annotations

import io
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from eal_actors.cli.work import work_progress
from tests.cli.conftest import Write

STEPS = "steps: [{on: all, do: [{send_cmd: {resource: Base, cmd: l360}}]}]\n"


def shown(*, is_terminal: bool, parts: int, total: int, finished: int = 0, of: str = "") -> str:
    """Return what a console shows of some parts of work, of which the third is important."""
    console = Console(file=io.StringIO(), force_terminal=is_terminal, width=80, no_color=True)
    with work_progress(console, "run", total, finished, of) as on_done:
        for number in range(1, parts + 1):
            on_done(f"part {number}", number == 3)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_a_pipe_gets_a_line_for_each_part_and_a_summary() -> None:
    *lines, summary = shown(is_terminal=False, parts=3, total=7, finished=4).splitlines()
    assert lines == ["5/7  part 1", "6/7  part 2", "7/7  part 3"]
    assert re.fullmatch(r"3 runs in \d+\.\d s, [\d.]+ per (second|minute)", summary)


def test_a_terminal_gets_a_bar_with_rate_and_rest_and_what_is_important() -> None:
    text = shown(is_terminal=True, parts=5, total=5)
    for words in ("runs", "5/5", "per ", "left:", "part 3"):
        assert words in text
    assert "part 2" not in text


def test_the_bar_has_one_line_whatever_it_says() -> None:
    text = shown(is_terminal=True, parts=5, total=5, of=" of evbot2-1, before")
    assert "runs of evbot2-1, before" in text
    assert "5 runs of evbot2-1, before in " in text
    bars = [line for line in re.split(r"[\r\n]+", re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "\r", text)) if "left:" in line]
    assert bars
    assert all("per " in line for line in bars if "5/5" in line)


def test_the_first_part_may_tell_how_many_there_are() -> None:
    console = Console(file=io.StringIO())
    with work_progress(console, "run", None) as on_done:
        on_done("one", False, 2)
        on_done("two", False, 2)
    assert isinstance(console.file, io.StringIO)
    *lines, summary = console.file.getvalue().splitlines()
    assert lines == ["1/2  one", "2/2  two"]
    assert summary.startswith("2 runs in ")


def test_the_summary_says_how_much_was_done() -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert "2 of 9 runs in " in shown(is_terminal=False, parts=2, total=9)
    assert shown(is_terminal=False, parts=1, total=1) == "1/1  part 1\n"


def interrupted() -> None:
    with work_progress(Console(file=io.StringIO()), "run", 9) as on_done:
        on_done("one", False)
        raise KeyboardInterrupt


def test_ctrl_c_shows_the_rehearsals_that_are_done(start: Callable[..., Any], write: Write, tmp_path: Path) -> None:
    scenario = write("s.yaml", f"version: 1\nname: s\nroles: {{all: {{}}}}\n{STEPS}")
    fleet = write("f.yaml", "version: 1\nrobots: {one: {plugins: {sim: {model: roomba}}}}\n")
    process = start("rehearse", scenario, "--fleet", fleet, "--seeds", 1000)
    for line in process.stderr:
        if line.startswith("2/1000"):
            break
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    done = re.search(r"Stopped after (\d+) seeds of 1000", out)
    assert done is not None, out + err
    assert int(done[1]) >= 2
    assert "one" in out
