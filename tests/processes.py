"""The program `eal` in processes of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from eal_actors.kernel.bundled import bundled_path


@contextmanager
def eal_processes(folder: Path, environment: Mapping[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start `eal` with some arguments in a folder, with pipes for its output; the end kills every process."""
    processes: list[subprocess.Popen[str]] = []

    def start(*arguments: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, "-m", "eal_actors", *arguments],
            cwd=folder,
            env={**environment, "PYTHONPATH": str(bundled_path("."))},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    try:
        yield start
    finally:
        for process in processes:
            process.kill()
            process.communicate()
