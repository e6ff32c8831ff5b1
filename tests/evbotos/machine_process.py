"""The services of a machine in a folder, each in a process: `python -m tests.evbotos.machine_process FOLDER ROBOT`.

It starts the slot that the loader chose, serves the robot, marks the slot good once the robot serves, and runs the
program of root when the robot's process wakes it. Its parts are the image's own; only the kernel and the boot loader
are missing.
"""

from __future__ import annotations

import grp
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.evbotos.machine_rig import POWER, comes_true, point_at, program

_Write = Callable[[Any, dict[str, Any], bytes], bytes]


def losing_power(write: _Write, folder: Path) -> _Write:
    """Return a session's `_write` that kills the whole machine, without an answer, once enough has been written."""
    written = 0

    def written_until_the_cut(session: Any, asked: dict[str, Any], body: bytes) -> bytes:
        nonlocal written
        answer, written = write(session, asked, body), written + len(body)
        if (folder / POWER).is_file() and written >= int((folder / POWER).read_text()):
            os.killpg(0, signal.SIGKILL)
        return answer

    return written_until_the_cut


def main(folder: Path, robot: str) -> None:
    """Run the machine until it is killed."""
    with pytest.MonkeyPatch.context() as patch:
        installation, serve = point_at(folder, patch), program("serve", patch)
        patch.setattr(serve, "STATE", folder)
        patch.setattr(serve.Session, "_write", losing_power(serve.Session._write, folder))
        patch.setattr(serve, "_START", folder / "start")
        patch.setattr(serve, "_GROUP", grp.getgrgid(os.getgid()).gr_name)
        patch.setenv("PATH", f"{folder}/bin:{os.environ['PATH']}")
        words = ["-m", "eal_actors", "serve", "--fleet", str(folder / "fleet.yaml"), "--robot", robot]
        with (
            (folder / "serve.log").open("ab") as log,
            subprocess.Popen([sys.executable, *words], stdout=log, stderr=log),
        ):
            assert comes_true(lambda: "listening at" in (folder / "serve.log").read_text())
            installation.mark_good()
            (folder / "update.wake").unlink(missing_ok=True)
            os.mkfifo(folder / "update.wake")
            while True:
                with (folder / "update.wake").open("rb") as pipe:
                    pipe.readline()
                serve.serve()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
