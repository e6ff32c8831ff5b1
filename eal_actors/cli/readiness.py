"""The lines by which programs that `eal` starts say that they are ready."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
from typing import Final

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import UnavailableError

START_S: Final = 60.0
"""Real seconds until a program that is not ready is killed. With OpenCV, one takes 20 s on a slow board."""


def kill(process: subprocess.Popen[str]) -> None:
    """Kill a program, and its children if it has a session of its own: they hold its output, too."""
    try:
        os.killpg(process.pid, signal.SIGKILL)  # its children remain in the group if it has ended
    except ProcessLookupError:
        process.kill()


def ready_line(process: subprocess.Popen[str], program: str, robot: str, begin: str = "") -> str:
    """Return the first line of a program's output that begins so; an empty one is skipped.

    Raises UnavailableError if the program has ended instead, or was not ready in time, and was killed.
    """
    end_s = REAL_TIME.now() + START_S
    time_out = threading.Timer(START_S, kill, (process,))
    time_out.daemon = True
    time_out.start()
    try:
        for line in process.stdout or ():
            if line.strip() and line.startswith(begin):
                return line.rstrip()
    finally:
        time_out.cancel()
    if REAL_TIME.now() < end_s:
        raise UnavailableError(f"its {program} has ended; see its message above", robot=robot)
    raise UnavailableError(f"its {program} was not ready within {START_S:g} s, and was killed", robot=robot)
