"""The program as a process: signals, exit codes, pipes, and the live display on a terminal."""

import json
import os
import pty
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path

Start = Callable[..., subprocess.Popen[str]]

LONG = """\
version: 1
name: long
description: Move for long, and back at the end.
roles: {movers: {robots: [one]}}
timeout_s: 100
steps:
  - on: movers
    do:
      - send_cmd: {resource: Slide, cmd: to1}
finally:
  - on: movers
    do:
      - set_config: {resource: Slide, key: speed_m_s, value: 0.01}
      - send_cmd: {resource: Slide, cmd: "to${FINALLY}"}
"""


def lines_until(process: subprocess.Popen[str], words: str) -> list[str]:
    """Read stdout up to a line that contains the words."""
    assert process.stdout is not None
    lines = []
    for line in process.stdout:
        lines.append(line)
        if words in line:
            return lines
    raise AssertionError(f"{words!r} never came: {lines}, {process.communicate()[1]}")


def summary(runs: Path) -> dict[str, Any]:
    (directory,) = runs.iterdir()
    found: dict[str, Any] = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
    return found


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_stops_the_run_in_good_order(start: Start, slides: Path, write: Any, number: signal.Signals) -> None:
    scenario = write("long.yaml", LONG.replace("to${FINALLY}", "s"))
    process = start("run", scenario, "--fleet", slides)
    lines_until(process, "send_cmd Slide to1")
    process.send_signal(number)
    out, err = process.communicate()
    assert process.returncode == 130
    assert "send_cmd Slide to1  aborted" in out
    assert "send_cmd Slide s  done" in out
    assert f"interrupted by {number.name}" in out
    assert err.startswith("Stopping: ")
    assert "Traceback" not in err
    report = summary(slides.parent / "runs")
    assert report["outcome"] == "aborted"
    assert [step["outcome"] for step in report["steps"]] == ["aborted", "done", "done"]


def test_a_second_signal_skips_the_rest_of_finally(start: Start, slides: Path, write: Any) -> None:
    scenario = write("long.yaml", LONG.replace("to${FINALLY}", "to0.9"))
    process = start("run", scenario, "--fleet", slides)
    lines_until(process, "send_cmd Slide to1")
    process.send_signal(signal.SIGINT)
    lines_until(process, "send_cmd Slide to0.9")
    process.send_signal(signal.SIGINT)
    process.communicate()  # it would last 90 s
    assert process.returncode == 130
    assert [step["outcome"] for step in summary(slides.parent / "runs")["steps"]] == ["aborted", "done", "aborted"]


def break_brake(slides: Path) -> None:
    """Make the robots' halt hang."""
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    text = plugin.read_text(encoding="utf-8")
    hang = '"""Stop at once."""\n        import threading\n        threading.Event().wait()\n'
    plugin.write_text(text.replace('"""Stop at once."""\n', hang), encoding="utf-8")


def test_each_further_signal_ends_more_and_the_last_ends_a_robot_that_hangs(
    start: Start, slides: Path, write: Any
) -> None:
    break_brake(slides)
    process = start("run", write("long.yaml", LONG.replace("to${FINALLY}", "s")), "--fleet", slides)
    lines_until(process, "send_cmd Slide to1")
    assert process.stderr is not None
    for words in ("Stopping: ", "Stopping now", "Disconnecting"):
        process.send_signal(signal.SIGINT)
        assert any(line.startswith(words) for line in process.stderr)
    process.send_signal(signal.SIGINT)
    process.communicate()
    assert process.returncode == 130


@pytest.mark.parametrize("hangs", [False, True])
def test_a_storm_of_signals_ends_with_the_same_code(start: Start, slides: Path, write: Any, hangs: bool) -> None:
    if hangs:
        break_brake(slides)
    process = start("run", write("long.yaml", LONG.replace("to${FINALLY}", "to0.9")), "--fleet", slides)
    lines_until(process, "send_cmd Slide to1")
    while process.poll() is None:
        process.send_signal(signal.SIGINT)
    assert process.returncode == 130


@pytest.mark.parametrize("terminal_kind", ["xterm-256color", "dumb"])
def test_a_terminal_that_is_closed_stops_the_run_in_good_order(
    start: Start, slides: Path, write: Any, monkeypatch: pytest.MonkeyPatch, terminal_kind: str
) -> None:
    monkeypatch.setenv("TERM", terminal_kind)
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    text = plugin.read_text(encoding="utf-8")
    noting = "        with open('halts', 'a') as halts:\n            halts.write(f'{self._moves} ')\n"
    text = text.replace(
        "        self._moves = False\n\n    @command", f"{noting}        self._moves = False\n\n    @command"
    )
    plugin.write_text(text, encoding="utf-8")
    scenario = write("long.yaml", LONG.replace("to${FINALLY}", "s"))
    ours, theirs = pty.openpty()
    process = start("run", scenario, "--fleet", slides, terminal=os.ttyname(theirs))
    seen = b""
    while b"Slide to1" not in seen:
        seen += os.read(ours, 65536)
    os.close(theirs)
    os.close(ours)
    assert process.wait() == 130
    assert (slides.parent / "halts").read_text(encoding="utf-8")  # it may have been stopped before it moved
    report = summary(slides.parent / "runs")
    assert report["error"]["message"] == "aborted: interrupted by SIGHUP"
    assert [step["outcome"] for step in report["steps"]] == ["aborted", "done", "done"]


def test_a_terminal_is_closed_once_however_often_one_is_told(start: Start, slides: Path, write: Any) -> None:
    text = LONG.replace("to${FINALLY}", "to0.9").replace("value: 0.01", "value: 0.5")
    process = start("run", write("long.yaml", text), "--fleet", slides)
    lines_until(process, "send_cmd Slide to1")
    process.send_signal(signal.SIGHUP)
    lines_until(process, "send_cmd Slide to0.9")
    process.send_signal(signal.SIGHUP)
    process.communicate()
    assert process.returncode == 130
    assert [step["outcome"] for step in summary(slides.parent / "runs")["steps"]] == ["aborted", "done", "done"]


def test_nohup_is_heeded(start: Start, slides: Path, write: Any) -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # which the process inherits
    try:
        process = start(
            "run", write("short.yaml", LONG.replace("to1", "to0.1").replace("to${FINALLY}", "s")), "--fleet", slides
        )
    finally:
        signal.signal(signal.SIGHUP, before)
    lines_until(process, "send_cmd Slide to0.1")
    process.send_signal(signal.SIGHUP)
    lines_until(process, "send_cmd Slide to0.1  done")
    process.kill()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP])
def test_a_signal_during_a_call_halts_what_moves(start: Start, slides: Path, number: signal.Signals) -> None:
    plugin = slides.parent / "plugins" / "slide" / "plugin.py"
    text = plugin.read_text(encoding="utf-8")
    telling = text.replace(
        "        self._moves = True\n", "        self._moves = True\n        print('moves', flush=True)\n"
    )
    telling = telling.replace(
        "            self.halt()  #", "            print('stands', flush=True)\n            self.halt()  #"
    )
    plugin.write_text(telling, encoding="utf-8")
    process = start("call", "one", "Slide", "send_cmd", "to1", "--timeout-s", 100, "--fleet", slides)
    lines_until(process, "moves")
    process.send_signal(number)
    out, err = process.communicate()
    assert (process.returncode, out, err) == (130, "stands\n", "")


def test_the_exit_code_of_each_kind_reaches_the_shell(start: Start, slides: Path, half_dead: Path, move: Path) -> None:
    cases = {
        0: ("run", move, "--fleet", slides, "--rate", 10),
        1: ("call", "one", "Slide", "send_cmd", "to1", "--timeout-s", 0.05, "--fleet", slides),
        2: ("call", "one", "Slide", "send_cmd", "to5", "--fleet", slides),
        3: ("resources", "--fleet", half_dead),
    }
    processes = {code: start(*arguments) for code, arguments in cases.items()}
    for code, process in processes.items():
        _, err = process.communicate()
        assert (process.returncode, "Traceback" in err) == (code, False), err


def test_a_pipe_gets_plain_text(start: Start, slides: Path, move: Path) -> None:
    for arguments in (("run", move, "--fleet", slides, "--rate", 10), ("resources", "--fleet", slides), ("--help",)):
        out, err = start(*arguments).communicate()
        assert out
        assert "\x1b" not in out + err


def test_a_terminal_without_unicode_gets_all_lines(
    start: Start, slides: Path, write: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")
    text = LONG.replace("to1", "to0.02").replace("to${FINALLY}", "s").replace("steps:\n", "steps:\n  - log: hō– ü\n")
    file = write("kō.yaml", text.replace("Move for", "Ein bißchen –"))
    out, err = start("run", file, "--fleet", slides, "--rate", 10, "--no-plot").communicate()
    assert "h\\u014d\\u2013 \\xfc" in out
    assert "long on slides: done" in out
    assert "Traceback" not in err
    process = start("check", file, "--json")
    assert json.loads(process.communicate()[0])["files"][0]["file"] == str(file)


def test_lines_in_a_pipe_stay_whole(start: Start, slides: Path, write: Any) -> None:
    name = "a" * 150
    slides.write_text(slides.read_text(encoding="utf-8").replace("  one:", f"  {name}:"), encoding="utf-8")
    out, _ = start("call", name, "Slide", "get_valu", "--fleet", slides).communicate()
    process = start("run", write("nothing.yaml", "version: 1\n"), "--fleet", slides)
    _, err = process.communicate()
    assert err.splitlines()[-2] == "2 problems; nothing was done."
    assert out == ""
    _, err = start("call", name, "Slid", "get_value", "--fleet", slides).communicate()
    assert err.splitlines()[0] == f"Error: {name}: unknown resource 'Slid'; did you mean 'Slide'?"


def test_a_reader_that_goes_away_stops_no_run(start: Start, slides: Path, move: Path) -> None:
    process = start("run", move, "--fleet", slides)
    lines_until(process, "move on slides")
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    assert process.stderr.read() == ""
    assert process.wait() == 0
    assert summary(slides.parent / "runs")["outcome"] == "done"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_output_that_finds_no_room_stops_no_run_but_is_told(
    start: Start, slides: Path, move: Path, options: tuple[str, ...]
) -> None:
    with Path("/dev/full").open("w", encoding="utf-8") as full:
        process = start("run", move, "--fleet", slides, "--rate", 10, "--no-plot", *options, stdout=full.fileno())
        _, err = process.communicate()
    assert process.returncode == 1
    assert err.count("Error: stdout cannot be written: No space left on device\n") == 1
    assert "Traceback" not in err
    assert summary(slides.parent / "runs")["outcome"] == "done"


def test_a_record_that_finds_no_room_ends_the_run_in_good_order(start: Start, slides: Path, write: Any) -> None:
    scenario = write("short.yaml", LONG.replace("to1", "to0.1").replace("to${FINALLY}", "s"))
    process = start("run", scenario, "--fleet", slides)
    lines_until(process, "send_cmd Slide to0.1")
    resource.prlimit(
        process.pid, resource.RLIMIT_FSIZE, (100, resource.RLIM_INFINITY)
    )  # a file size limit acts like a full disk
    out, err = process.communicate()
    assert process.returncode == 1
    (record,) = (slides.parent / "runs").iterdir()
    assert f"its record in {record.relative_to(slides.parent)} cannot be written: File too large" in err
    assert "send_cmd Slide s  done" in out
    assert "Traceback" not in err


def test_closed_standard_streams_stop_no_run(start: Start, slides: Path, move: Path) -> None:
    closing = "import os, sys; os.closerange(0, 3); os.execv(sys.executable, [sys.executable, *sys.argv[1:]])"
    run = [sys.executable, "-c", closing, "-m", "eal_actors", "run", move, "--fleet", slides, "--rate", "10"]
    environment = {**os.environ, "PYTHONPATH": str(bundled_path("."))}
    process = subprocess.run(list(map(str, run)), cwd=slides.parent, env=environment, check=False)
    assert process.returncode == 0
    assert summary(slides.parent / "runs")["outcome"] == "done"


LOADING = """
import _thread
class Field:
    def __set_name__(self, owner, name):
        _thread.interrupt_main()
class Fields:
    field = Field()
"""
"""A KeyboardInterrupt there comes out as RuntimeError before Python 3.12."""


@pytest.mark.parametrize(
    ("module", "arguments"),
    [("typer", ["--version"]), ("simpleeval", ["run", "dance"]), ("mcap", ["run", "dance", "--fleet", "sim"])],
)
def test_ctrl_c_while_the_program_loads_ends_it_without_a_word(
    tmp_path: Path, module: str, arguments: list[str]
) -> None:
    (tmp_path / f"{module}.py").write_text(LOADING, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{bundled_path('.')}"}
    command = [sys.executable, "-m", "eal_actors", *arguments]
    done = subprocess.run(command, env=environment, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "")


def test_ctrl_c_that_a_plugin_drops_ends_the_run_before_it_begins(start: Start, slides: Path, move: Path) -> None:
    """The import of OpenCV drops it, too."""
    plugin = slides.parent / "plugins/slide/plugin.py"
    dropped = (
        "import contextlib, signal\nwith contextlib.suppress(BaseException):\n    signal.raise_signal(signal.SIGINT)\n"
    )
    plugin.write_text(plugin.read_text(encoding="utf-8") + dropped, encoding="utf-8")
    process = start("run", move, "--fleet", slides, "--no-plot")
    out, err = process.communicate()
    assert (process.returncode, err) == (130, "")
    assert "move on slides" not in out


def on_a_terminal(start: Start, *arguments: object) -> tuple[int, str]:
    """Run the program with its stdout on a terminal; return its exit code and the terminal's input."""
    ours, theirs = pty.openpty()
    got: list[bytes] = []

    def read() -> None:
        while True:
            try:
                got.append(os.read(ours, 65536))
            except OSError:  # the other end is closed
                return

    process = start(*arguments, stdout=theirs)
    os.close(theirs)
    reader = threading.Thread(target=read)
    reader.start()
    _, err = process.communicate()
    reader.join()
    os.close(ours)
    assert "Traceback" not in err
    return process.returncode, b"".join(got).decode()


def test_a_terminal_gets_a_live_table_that_is_gone_at_the_end(
    start: Start, slides: Path, move: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    code, text = on_a_terminal(start, "run", move, "--fleet", slides, "--rate", "0.5")
    assert code == 0
    assert "\x1b[?25l" in text  # the cursor is hidden
    assert "0/4 calls" in text
    assert "running" in text
    last = text.rindex("\x1b[?25h")  # and shown again
    assert "running" not in text[last:]
    assert "move on slides: \x1b[32mdone" in text[last:]


def test_no_color_is_heeded(start: Start, slides: Path, move: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", "1")
    code, text = on_a_terminal(start, "run", move, "--fleet", slides, "--rate", "10")
    assert code == 0
    assert "move on slides: done" in text
    assert "\x1b[3" not in text


def test_a_dumb_terminal_gets_plain_lines(
    start: Start, slides: Path, move: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "dumb")
    code, text = on_a_terminal(start, "run", move, "--fleet", slides, "--rate", "10")
    assert code == 0
    assert "one  send_cmd Slide to0.02" in text
    assert "\x1b" not in text
