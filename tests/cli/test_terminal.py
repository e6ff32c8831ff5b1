"""Texts of robots and of other controllers do not control the terminal of their reader."""

from __future__ import annotations

import io

import pytest
from rich.text import Text

from eal_actors.cli import output
from eal_actors.kernel.log import configure_logging, get_logger
from eal_actors.kernel.printable import printable

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


def test_printable_texts_stay_as_they_are() -> None:
    assert printable("Grüße, 3 µs\n\tnext line 🤖") == "Grüße, 3 µs\n\tnext line 🤖"
    assert printable("\x1b[31mred") == r"\x1b[31mred"
