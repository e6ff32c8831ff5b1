"""`eal` in processes of its own."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eal_actors.kernel.bundled import bundled_path


@contextmanager
def started_programs(folder: Path, environment: Mapping[str, str]) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Yield a function that starts `eal` in a folder; kill its processes at the end.

    The function takes the arguments of `eal`, a `wrapper` (the start of the command line), and options of `Popen`.
    """
    processes: list[subprocess.Popen[str]] = []

    def start(*arguments: object, wrapper: Sequence[str] = (), **options: Any) -> subprocess.Popen[str]:
        command = [*wrapper, sys.executable, "-m", "eal_actors", *map(str, arguments)]
        options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
        full_environment = {**environment, "PYTHONPATH": str(bundled_path("."))}
        process = subprocess.Popen(command, cwd=folder, env=full_environment, text=True, **options)
        processes.append(process)
        return process

    yield start
    for process in processes:
        process.kill()
        process.wait()
        for pipe in (process.stdout, process.stderr):
            if pipe is not None:
                pipe.close()
