"""The program `eal`, in this process or in its own, and terminals for it."""

import os
import pty
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from typer.testing import CliRunner, Result

from eal_actors.cli import app
from eal_actors.kernel.bundled import bundled_path


def run_eal(*arguments: object) -> Result:
    """Run the program in this process; an exception that it lets through fails the test."""
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result


@contextmanager
def eal_processes(folder: Path) -> Iterator[Callable[..., "subprocess.Popen[str]"]]:
    """Yield a function that starts `eal` in a folder, with pipes for its output; kill every process at the end."""
    processes: list[subprocess.Popen[str]] = []

    def start(
        *arguments: object, environment: Mapping[str, str], prefix: tuple[str, ...] = (), **options: Any
    ) -> "subprocess.Popen[str]":
        process: subprocess.Popen[str] = subprocess.Popen(
            [*prefix, sys.executable, "-m", "eal_actors", *map(str, arguments)],
            cwd=folder,
            env={**environment, "PYTHONPATH": str(bundled_path("."))},
            stderr=subprocess.PIPE,
            text=True,
            **{"stdout": subprocess.PIPE, **options},
        )
        processes.append(process)
        return process

    try:
        yield start
    finally:
        for process in processes:
            process.kill()
            process.wait()
            for pipe in (process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()


@contextmanager
def paused_terminal() -> Iterator[int]:
    """Yield a terminal that is paused, as by Ctrl-S."""
    ends = pty.openpty()
    try:
        termios.tcflow(ends[1], termios.TCOOFF)
        yield ends[1]
    finally:
        for end in ends:
            os.close(end)
