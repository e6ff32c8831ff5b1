"""The services of a machine in a folder, each in a process: `python -m tests.evbotos.machine_process FOLDER ROBOT`.

It starts the slot that the loader chose, serves the robot, marks the slot good once the robot serves, and runs the
program of root when the robot's process wakes it. Its parts are the image's own; only the kernel and the boot loader
are missing.
"""

from __future__ import annotations

import grp
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.evbotos.machine_rig import point_at, program
from tests.net.links import eventually


def main(folder: Path, robot: str) -> None:
    """Run the machine until it is killed."""
    with pytest.MonkeyPatch.context() as patch:
        installation, serve = point_at(folder, patch), program("serve", patch)
        patch.setattr(serve, "STATE", folder)
        patch.setattr(serve, "_START", folder / "start")
        patch.setattr(serve, "_GROUP", grp.getgrgid(os.getgid()).gr_name)
        patch.setenv("PATH", f"{folder}/bin:{os.environ['PATH']}")
        words = ["-m", "eal_actors", "serve", "--fleet", str(folder / "fleet.yaml"), "--robot", robot]
        with (
            (folder / "serve.log").open("ab") as log,
            subprocess.Popen([sys.executable, *words], stdout=log, stderr=log),
        ):
            assert eventually(lambda: "listening at" in (folder / "serve.log").read_text())
            installation.mark_good()
            (folder / "update.wake").unlink(missing_ok=True)
            os.mkfifo(folder / "update.wake")
            while True:
                with (folder / "update.wake").open("rb") as pipe:
                    pipe.readline()
                serve.serve()


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
