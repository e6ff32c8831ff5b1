"""The first hour: problems with their lines, errors as JSON, missing modules, and the picture at the end of a run."""

from __future__ import annotations

import base64
import json
import os
import pty
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from eal_actors.kernel.bundled import bundled_path
from eal_actors.recording import RunFolder
from eal_actors.recording.film import film_run
from tests.cli.conftest import Program, Write


def test_a_problem_shows_its_line_with_a_caret(eal: Program, write: Write) -> None:
    file = write("f.yaml", "version: 1\nrobots:\n  a: {plugins: {sim: {model: roomba, pose: {x_m: 1}}}}\n")
    lines = eal("check", file).stdout.splitlines()
    assert lines[0].endswith("unknown key 'pose'; did you mean 'start'?")
    assert lines[1] == "      a: {plugins: {sim: {model: roomba, pose: {x_m: 1}}}}"
    assert lines[2].index("^") == lines[1].index("pose")


def test_a_long_line_is_cut_around_the_caret(eal: Program, write: Write) -> None:
    file = write(
        "f.yaml", f"version: 1\nrobots: {{a: {{tags: [{', '.join(['x'] * 200)}, 5], plugins: {{sample: {{}}}}}}}}\n"
    )
    _, line, caret, *_ = eal("check", file).stdout.splitlines()
    assert len(line) <= 80
    assert line[caret.index("^")] == "5"


def test_a_hundred_equal_problems_are_shown_three_times(eal: Program, write: Write) -> None:
    robots = "".join(f"  r{number}: {{plugins: {{sim: {{modl: roomba}}}}}}\n" for number in range(100))
    done = eal("check", write("f.yaml", f"version: 1\nrobots:\n{robots}"))
    assert "200 problems in 1 file" in done.stderr
    assert done.stdout.count("did you mean 'model'?") == 3
    assert "97 more with this problem, in lines 6, 7, 8, 9, 10, 11, 12, 13, ..." in done.stdout
    assert len(done.stdout.splitlines()) < 25


def test_one_more_equal_problem_is_in_a_line(eal: Program, write: Write) -> None:
    robots = "".join(f"  r{number}: {{plugins: {{sim: {{modl: roomba}}}}}}\n" for number in range(4))
    done = eal("check", write("f.yaml", f"version: 1\nrobots:\n{robots}"))
    assert "1 more with this problem, in line 6\n" in done.stdout


def test_problems_are_shown_in_the_order_of_the_file(eal: Program, write: Write) -> None:
    file = write("f.yaml", "version: 1\nrobots:\n  a: {x: 1}\n  b: {y: 1}\n  c: {x: 1}\n")
    told = [line for line in eal("check", file).stdout.splitlines() if line.startswith(str(file))]
    assert len(told) == 6
    assert [int(line.removeprefix(f"{file}:").split(":")[0]) for line in told] == [3, 3, 4, 4, 5, 5]


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["run", "dnace", "--fleet", "sim", "--json"], "config", "did you mean 'dance'?"),
        (["run", "--json"], "usage", "is missing"),
        (["resources", "--fleet", "sim", "--robot", "nobody", "--json"], "robot_not_found", "nobody"),
        (["resources", "--fleet", "sim", "--nonsense", "--json"], "usage", "--nonsense"),
    ],
)
def test_an_error_of_a_command_with_json_is_json(eal: Program, arguments: list[str], code: str, words: str) -> None:
    done = eal(*arguments)
    assert done.exit_code == 2
    error = json.loads(done.stdout)["error"]
    assert (error["code"], error["exit_code"]) == (code, 2)
    assert words in error["message"]
    assert not done.stderr


def test_a_run_ends_in_a_film(eal: Program, write: Write, tmp_path: Path) -> None:
    steps = "steps: [{on: all, do: [{send_cmd: {resource: Base, cmd: l90}}]}]\n"
    scenario = write("s.yaml", f"version: 1\nname: s\nroles: {{all: {{}}}}\n{steps}")
    fleet = write("f.yaml", "version: 1\nrobots: {one: {plugins: {sim: {model: roomba}}}}\n")
    runs = tmp_path / "runs"
    done = eal("run", scenario, "--fleet", fleet, "--rate", "max", "--film", "--no-plot", "--runs-dir", runs)
    assert done.exit_code == 0, done.output
    (film,) = runs.glob("*/trajectory.gif")
    assert f"gif: {film}" in done.output
    with Image.open(film) as frames:
        assert frames.n_frames > 10  # type: ignore[attr-defined]
        pictures = []
        for number in (0, frames.n_frames // 2):  # type: ignore[attr-defined]
            frames.seek(number)
            pictures.append(np.array(frames.convert("RGB")))
    assert (pictures[0] != pictures[1]).any(), "the robots turn"


def test_the_ninth_robot_of_a_film_has_the_first_ones_colour_and_another_shape(tmp_path: Path) -> None:
    rows = [f"robot{number},0.0,{number % 3},{number // 3},0\n" for number in range(9)]
    (tmp_path / "trajectory.csv").write_text("robot,time_s,x_m,y_m,yaw_rad\n" + "".join(rows))
    (tmp_path / "events.jsonl").touch()
    film = film_run(RunFolder.open(tmp_path), None)
    assert film is not None
    with Image.open(film) as opened:
        pixels = np.array(opened.convert("RGB")).astype(int)
    per_m = len(pixels) / (2 + 2 * 0.35)  # with the margins

    def colour(x_m: float, y_m: float) -> str:
        red, _, blue = pixels[round((2.35 - y_m) * per_m), round((0.35 + x_m) * per_m)]
        return "white" if red > 220 else "blue" if blue > 150 and red < 60 else "another"

    middle, rim = -0.05, -0.14  # of a robot's radius of 0.17 m, behind its heading
    assert [colour(x_m + middle, x_m) for x_m in (0, 2)] == ["blue", "white"]
    assert [colour(x_m + rim, x_m) for x_m in (0, 2)] == ["blue", "blue"]


def at_a_terminal(answer: bytes, picture: Path, **variables: str) -> bytes:
    """Return what a terminal receives that shows a picture; it answers the question for its attributes."""
    code = (
        "import sys; from pathlib import Path; from eal_actors.cli.inline_picture import show_inline; "
        "sys.stdout.write(f'<{show_inline(sys.stdout, Path(sys.argv[1]))}>')"
    )
    controller, terminal = pty.openpty()
    environment = {"PATH": os.environ["PATH"], "PYTHONPATH": str(bundled_path(".")), "TERM": "xterm", **variables}
    command = [sys.executable, "-c", code, str(picture)]
    shown = subprocess.Popen(command, stdin=terminal, stdout=terminal, env=environment)
    os.close(terminal)
    received = bytearray()

    def read() -> None:
        while True:
            try:
                part = os.read(controller, 65536)
            except OSError:  # the program has ended
                return
            received.extend(part)
            if part.endswith(b"\x1b[c"):
                os.write(controller, answer)

    reader = threading.Thread(target=read)
    reader.start()
    assert shown.wait(120) == 0
    reader.join(30)
    os.close(controller)
    return bytes(received)


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A picture of four colours, in an odd size."""
    pixels = np.zeros((37, 50, 3), np.uint8)
    pixels[:20, 25:] = 255, 0, 0
    pixels[20:, :25] = 0, 255, 0
    pixels[20:, 25:] = 255, 255, 255
    file = tmp_path_factory.mktemp("picture") / "p.png"
    Image.fromarray(pixels).save(file)
    return file


def test_kitty_and_iterm_receive_the_file(picture: Path) -> None:
    received = at_a_terminal(b"", picture, TERM="xterm-kitty")
    parts = re.findall(rb"\x1b_G[^;]*;([^\x1b]*)\x1b\\", received)
    assert base64.b64decode(b"".join(parts)) == picture.read_bytes()
    received = at_a_terminal(b"", picture, TERM_PROGRAM="iTerm.app")
    (text,) = re.findall(rb"\x1b\]1337;File=inline=1;[^:]*:([^\a]*)\a", received)
    assert base64.b64decode(text) == picture.read_bytes()


def test_a_terminal_with_sixels_shows_the_pixels(picture: Path) -> None:
    received = at_a_terminal(b"\x1b[?62;4;22c", picture)
    (text,) = re.findall(rb"\x1bPq(.*)\x1b\\", received, re.DOTALL)
    with Image.open(picture) as opened:
        assert np.abs(decoded(text.decode(), opened.size).astype(int) - np.array(opened)).max() <= 3


def test_other_terminals_get_no_picture(picture: Path) -> None:
    for answer in (b"\x1b[?62;22c", b""):
        received = at_a_terminal(answer, picture)
        assert received.endswith(b"<False>")
        assert b"\x1bPq" not in received


def decoded(text: str, size: tuple[int, int]) -> Any:
    """Return the pixels of sixels, by the manual of the VT340."""
    width, height = size
    pixels = np.zeros((height, width, 3), np.uint8)
    palette: dict[int, list[int]] = {}
    colour = column = band = 0
    for symbol in re.findall(r'"[\d;]+|#\d+;2;\d+;\d+;\d+|#\d+|!\d+[?-~]|[$-]|[?-~]', text.replace("\r\n", "")):
        if symbol.startswith("#") and ";" in symbol:
            number, _, *rgb = map(int, symbol[1:].split(";"))
            palette[number] = [round(part * 255 / 100) for part in rgb]
        elif symbol.startswith("#"):
            colour = int(symbol[1:])
        elif symbol == "$":
            column = 0
        elif symbol == "-":
            column, band = 0, band + 6
        elif not symbol.startswith('"'):
            count = int(symbol[1:-1]) if symbol.startswith("!") else 1
            for bit in range(6):
                if (ord(symbol[-1]) - 63) >> bit & 1:
                    pixels[band + bit, column : column + count] = palette[colour]
            column += count
    return pixels


def without(modules: tuple[str, ...], call: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a process in which modules cannot be imported."""
    code = (
        "import importlib.util, sys\n"
        f"missing = {modules!r}\n"
        "sys.modules.update(dict.fromkeys(missing))\n"
        "find = importlib.util.find_spec\n"
        "importlib.util.find_spec = lambda name, *rest: None if name in missing else find(name, *rest)\n"
        f"sys.argv = [{call.split('.', maxsplit=1)[0]!r}, *{arguments!r}]\n"
        f"from {call} import main\nmain()\n"
    )
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["run", "dance", "--fleet", "sim"], 3),
        (["resources", "--fleet", "sim"], 3),
        (["check", "dance", "sim"], 0),
        (["rehearse", "dance", "--fleet", "sim"], 3),
        (["dashboard", "--fleet", "sim", "--port", "0"], 3),
        (["demo-network"], 3),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_a_missing_module_is_named_once_for_all_robots(arguments: list[str], code: int) -> None:
    done = without(("pymunk",), "eal_actors.cli.app", *arguments)
    assert done.returncode == code
    assert (done.stdout + done.stderr).count("pip install 'eal-actors[sim]'") == 1
    assert "[error" not in done.stdout + done.stderr


def test_the_lab_without_opencv_says_what_to_install() -> None:
    done = without(("cv2",), "eal_actors.cli.app", "lab", "square")
    assert done.returncode == 2
    assert "Error: plugin 'camera' needs cv2: pip install 'eal-actors[vision]'" in done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert not done.stdout


@pytest.mark.parametrize("module", ["cryptography", "cyclonedx", "packaging"])
def test_evbotos_without_its_extra_says_what_to_install(module: str) -> None:
    done = without((module,), "evbotos.__main__", "list")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"Error: evbotos needs {module}: pip install 'eal-actors[evbotos]'\n"
