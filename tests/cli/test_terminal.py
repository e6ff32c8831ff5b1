"""Texts of robots and of other controllers do not control the terminal of their reader."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from rich.text import Text

from eal_actors.cli import output
from eal_actors.kernel.log import configure_logging, get_logger
from eal_actors.kernel.printable import printable
from tests.cli.conftest import Program

HOSTILE = "stop\x1b[2J\x1b]52;c;cHduZWQ=\x07\r\x9b31m\u202e"
"""Clears the screen, sets the clipboard, overwrites the line and reverses the text."""


def test_results_show_control_characters_and_obey_none(capsys: pytest.CaptureFixture[str]) -> None:
    console = output.stdout()
    output.print_line(console, HOSTILE)
    console.print(HOSTILE)
    table = output.new_table("reason", "state")
    table.add_row(HOSTILE, Text(HOSTILE, style="red"))
    console.print(table)
    shown = capsys.readouterr().out
    assert not set(shown) & set("\x1b\x07\r\x9b\u202e")
    assert shown.count(r"stop\x1b[2J\x1b]52") == 4


def test_log_lines_show_control_characters_and_obey_none() -> None:
    stream = io.StringIO()
    configure_logging("human", "info", stream)
    get_logger(robot="r1").warning(HOSTILE, reason=HOSTILE)
    assert not set(stream.getvalue()) & set("\x1b\x07\r\x9b\u202e")
    assert r"\x1b[2J" in stream.getvalue()


def test_tracebacks_in_the_log_control_nothing() -> None:
    """The last line of a traceback is the text of the error, which may be that of a robot."""
    stream = io.StringIO()
    configure_logging("human", "info", stream)
    try:
        raise RuntimeError(HOSTILE)
    except RuntimeError:
        get_logger().exception("failed")
    assert not set(stream.getvalue()) & set("\x1b\x07\r\x9b\u202e")
    assert r"RuntimeError: stop\x1b[2J" in stream.getvalue()


def test_json_for_programs_controls_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    output.write_json({"reason": HOSTILE, "name": "Grüße 🤖"})
    shown = capsys.readouterr().out
    assert not set(shown) & set("\x1b\x07\r\x9b\u202e")
    assert json.loads(shown) == {"reason": HOSTILE, "name": "Grüße 🤖"}
    assert "Grüße 🤖" in shown


def test_a_file_in_an_error_of_usage_controls_no_terminal(eal: Program, tmp_path: Path) -> None:
    """Such errors took the console of typer, which obeys control characters."""
    event = {"event": "robot_lost", "time_s": 1, "robot": "one", "error": {"code": "x", "message": "y", HOSTILE: 1}}
    (tmp_path / "events.jsonl").write_text(json.dumps(event) + "\n")
    shown = eal("report", tmp_path).stderr
    assert "unknown key" in shown, shown
    assert not set(shown) & set("\x1b\x07\r\x9b\u202e")


def test_printable_texts_stay_as_they_are() -> None:
    assert printable("Grüße, 3 µs\n\tnext line 🤖") == "Grüße, 3 µs\n\tnext line 🤖"
    assert printable("\x1b[31mred") == r"\x1b[31mred"
