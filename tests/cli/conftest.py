"""Fixtures that run `eal` in this process or in its own, and the files for it."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent
from typing import IO

import pytest
import structlog
from typer.testing import Result

from eal_actors.cli.plugin import write_plugin
from tests.program import eal_processes, run_eal
from tests.scenario_texts import scenario_of

Program = Callable[..., Result]
Write = Callable[[str, str], Path]

FLEET = """\
version: 1
name: slides
plugin_dirs: [plugins]
robots:
  one: {tags: [wide], plugins: {slide: {}}}
  two: {plugins: {slide: {}}}
"""

MOVE = scenario_of(
    "send_cmd: {resource: Slide, cmd: to0.02}",
    "get_value: {resource: Slide}",
    name="move",
    role="movers",
    description="Move a little.",
)


@pytest.fixture
def eal(monkeypatch: pytest.MonkeyPatch) -> Iterator[Program]:
    """Run the program in this process, see `run_eal`."""
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.delenv("EAL_FLEET", raising=False)
    monkeypatch.delenv("FORCE_COLOR", raising=False)
    yield run_eal
    structlog.reset_defaults()  # it still refers to the captured stderr


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a text into a file, and return the file."""

    def write_file(name: str, text: str) -> Path:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(dedent(text), encoding="utf-8")
        return file

    return write_file


@pytest.fixture
def slides(tmp_path: Path, write: Write) -> Path:
    """A fleet of two slides, which take 10 s for `to1`."""
    write_plugin("slide", tmp_path / "plugins")
    return write("slides.yaml", FLEET)


@pytest.fixture
def half_dead(slides: Path, write: Write) -> Path:
    """A fleet whose robot `lost` has a plugin that cannot connect."""
    plugin = slides.parent / "plugins" / "slide"
    text = (plugin / "plugin.py").read_text(encoding="utf-8")
    write("plugins/dead/plugin.yaml", (plugin / "plugin.yaml").read_text(encoding="utf-8").replace("slide", "dead", 1))
    write(
        "plugins/dead/plugin.py",
        text.replace("return EALPlugin(", "raise OSError('no such port')\n    return EALPlugin("),
    )
    return write("half_dead.yaml", FLEET.replace("  two: {plugins: {slide: {}}}", "  lost: {plugins: {dead: {}}}"))


@pytest.fixture
def move(write: Write) -> Path:
    return write("move.yaml", MOVE)


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start the program with pipes for its output, or on a terminal of its own."""
    with eal_processes(tmp_path) as start_eal:

        def start_program(
            *arguments: object, stdout: int | IO[str] = subprocess.PIPE, terminal: str | None = None
        ) -> subprocess.Popen[str]:
            unwanted = {"COLUMNS", "EAL_FLEET", "FORCE_COLOR"}
            environment = {name: value for name, value in os.environ.items() if name not in unwanted}
            prefix = () if terminal is None else ("/bin/sh", "-c", 'exec "$@" <>"$0" >&0 2>&0', terminal)
            # A new session makes the terminal its controlling terminal, which sends the hang-up.
            return start_eal(
                *arguments,
                environment=environment,
                prefix=prefix,
                stdout=stdout,
                start_new_session=terminal is not None,
            )

        yield start_program
