"""The keys that control a run, on a real terminal."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.clock import REAL_TIME

WAIT_S = 30.0
SCENARIO = """\
version: 1
name: long
roles: {movers: {}}
timeout_s: 100
steps:
  - on: movers
    do:
      - repeat: 40
        do: [{wait_s: 0.1}]
"""


class Terminal:
    """A terminal with `eal run` in its foreground."""

    def __init__(self, folder: Path, fleet: Path) -> None:
        (folder / "long.yaml").write_text(SCENARIO)
        self.runs = folder / "runs"
        self.master, self.slave = pty.openpty()
        self.before = termios.tcgetattr(self.slave)
        self.shown = ""
        command = [sys.executable, "-m", "eal_actors", "run", str(folder / "long.yaml"), "-f", str(fleet)]
        self.process = subprocess.Popen(
            [*command, "--runs-dir", str(self.runs), "--no-plot"],
            stdin=self.slave,
            stdout=self.slave,
            stderr=self.slave,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "140"},
            start_new_session=True,
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
        )

    def wait_for(self, text: str) -> None:
        """Read the terminal until it shows a text."""
        end_s = REAL_TIME.now() + WAIT_S
        while text not in self.shown:
            assert REAL_TIME.now() < end_s, self.shown
            if select.select([self.master], [], [], 0.1)[0]:
                self.shown += os.read(self.master, 65536).decode(errors="replace")

    def press(self, keys: bytes) -> None:
        self.shown = ""
        os.write(self.master, keys)

    def end(self) -> int:
        """Return the exit code; read the output meanwhile as a terminal does."""
        end_s = REAL_TIME.now() + WAIT_S
        while self.process.poll() is None:
            assert REAL_TIME.now() < end_s, self.shown
            if select.select([self.master], [], [], 0.1)[0]:
                self.shown += os.read(self.master, 65536).decode(errors="replace")
        return self.process.returncode

    def is_as_before(self) -> bool:
        return termios.tcgetattr(self.slave) == self.before

    def events(self) -> list[dict[str, Any]]:
        (directory,) = self.runs.iterdir()
        return [json.loads(line) for line in (directory / "events.jsonl").read_text().splitlines()]


@pytest.fixture
def terminal(tmp_path: Path, slides: Path) -> Iterator[Terminal]:
    opened = Terminal(tmp_path, slides)
    yield opened
    opened.process.kill()
    opened.process.wait(WAIT_S)
    os.close(opened.master)
    os.close(opened.slave)


def test_space_pauses_and_goes_on_and_s_takes_one_step(terminal: Terminal) -> None:
    terminal.wait_for("space: pause")
    terminal.press(b" ")
    terminal.wait_for("paused")
    terminal.press(b"s")
    terminal.press(b" ")

    assert terminal.end() == 0, terminal.shown
    assert terminal.is_as_before()
    kinds = [event for event in terminal.events() if event["event"] in ("run_paused", "run_resumed")]
    assert [event.get("is_single_step") for event in kinds] == [None, True, False]


def test_q_stops(terminal: Terminal) -> None:
    terminal.wait_for("space: pause")
    terminal.press(b"q")

    assert terminal.end() == 1, terminal.shown
    assert terminal.is_as_before()
    assert terminal.events()[-1]["report"]["error"]["message"] == "aborted: stopped by the key q"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_terminal_is_as_it_was_after_a_signal(terminal: Terminal, number: int) -> None:
    terminal.wait_for("space: pause")
    terminal.process.send_signal(number)

    assert terminal.end() == 130, terminal.shown
    assert terminal.is_as_before()
