"""Each tutorial is done as a reader does it: page by page, block by block, in an empty folder.

A block whose first line is a comment with a path is the file of that path; blocks in `sh` are typed, all of a page in
one shell; `sh slow` takes minutes and is typed under the marker `evbotos`. Blocks in `console` show what depends on the
reader's machine.
"""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.net.links import free_port

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))
BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"# ([\w./-]+\.\w+)\n")
ADDRESS = "127.0.0.1:50443"

pytestmark = pytest.mark.docs


class Block(NamedTuple):
    """A code block of a page."""

    kind: str
    text: str

    @property
    def file(self) -> str | None:
        """The path that it says it is to be kept at."""
        found = FILE.match(self.text)
        return found.group(1) if found else None


def blocks(page: Path) -> list[Block]:
    return [Block(match.group(1).strip(), match.group(2)) for match in BLOCK.finditer(page.read_text())]


def script(page: Path, *, slow: bool) -> str:
    """Return what a reader of the page types, as one script that ends at the first failure."""
    lines = ["set -euo pipefail", "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT"]
    for number, block in enumerate(blocks(page)):
        if block.file is not None:
            lines += [
                f"mkdir -p {Path(block.file).parent}",
                f"cat > {block.file} <<'END-{number}'",
                f"{block.text}END-{number}",
            ]
        elif block.kind == "sh" or (block.kind == "sh slow" and slow):
            lines.append(block.text)
    return "\n".join(lines).replace(ADDRESS, f"127.0.0.1:{free_port()}")


def do(page: Path, folder: Path, *, slow: bool = False, **variables: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "EAL_FLEET"}
    environment |= {
        "PATH": f"{sysconfig.get_path('scripts')}:{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NO_COLOR": "1",
        **variables,
    }
    done = subprocess.run(
        ["bash", "-c", script(page, slow=slow)],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=3000 if slow else 600,
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


@contextmanager
def emulated_create() -> Iterator[str]:
    """Have a Create 2 on a terminal for the length of the block; yields the port."""
    command = [sys.executable, "-m", "plugins.roomba.emulator", "--protocol", "oi", "--pty"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as emulator:
        assert emulator.stdout is not None
        try:
            yield emulator.stdout.readline().strip()
        finally:
            emulator.terminate()
            emulator.communicate(timeout=60)


def tutorial(name: str) -> Path:
    return ROOT / "docs/tutorials" / f"{name}.md"


def test_every_tutorial_is_done_by_a_test() -> None:
    done = {"first-robot", "own-plugin", "real-roomba", "own-scenario", "secure-fleet", "evbotos-card"}
    assert {page.stem for page in TUTORIALS} == done
    for page in TUTORIALS:
        kinds = {(block.kind, block.file is not None) for block in blocks(page)}
        known = {("sh", False), ("sh slow", False), ("console", False), ("yaml", True), ("python", True)}
        assert kinds <= known, f"{page.name}: a block that no test tries: {kinds - known}"


@pytest.mark.timeout(700)
def test_a_first_robot(tmp_path: Path) -> None:
    said = do(tutorial("first-robot"), tmp_path)

    assert "home.yaml: ok (fleet, 1 robot)" in said
    x_m, y_m = map(float, re.findall(r"back at (\S+) m, (\S+) m", said)[0])
    assert math.dist((x_m, y_m), (-1.5, -1.0)) < 0.15
    (run,) = (tmp_path / "runs").iterdir()
    assert (run / "trajectory.png").stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_plugin_of_ones_own(tmp_path: Path) -> None:
    said = do(tutorial("own-plugin"), tmp_path)

    assert said.count("plugins/lamp: conforms") == 2
    assert "1 passed" in said
    assert "refused, as it should be" in said


@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_real_roomba_which_here_is_emulated(tmp_path: Path) -> None:
    with emulated_create() as port:
        said = do(tutorial("real-roomba"), tmp_path, ROOMBA_PORT=port)

    assert "look on home" in said


@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_scenario_of_ones_own(tmp_path: Path) -> None:
    do(tutorial("own-scenario"), tmp_path)

    (run,) = (tmp_path / "runs").iterdir()
    assert (run / "report.html").is_file()
    assert {file.parent.name for file in run.glob("*/pose.csv")} == {"evbot2-1", "evbot3-1", "roomba-1"}
    assert (tmp_path / "sweeps/greet/table.csv").read_text().count("\n") == 5


@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_secure_fleet(tmp_path: Path) -> None:
    said = do(tutorial("secure-fleet"), tmp_path)

    assert "does not grant set_value to 'display', which has the role observer there" in said
    assert said.count("refused, as it should be") == 2
    assert "rover: stored and in force" in said
    assert "listening at tls/127.0.0.1" in (tmp_path / "rover.log").read_text()


@pytest.mark.slow
@pytest.mark.timeout(700)
def test_a_card_with_evbotos_up_to_its_plan(tmp_path: Path) -> None:
    assert "qemu-amd64 robot: " in do(tutorial("evbotos-card"), tmp_path)


@pytest.mark.evbotos
@pytest.mark.timeout(3300)
def test_a_card_with_evbotos(tmp_path: Path) -> None:
    do(tutorial("evbotos-card"), tmp_path, slow=True)

    image = next((tmp_path / "out/qemu-amd64-robot").glob("disk.img"))
    with image.open("rb") as built, (tmp_path / "card.img").open("rb") as card:
        assert built.read() == card.read(image.stat().st_size)
