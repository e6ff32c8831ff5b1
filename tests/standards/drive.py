"""Run scenarios/standards.yaml with `eal run` in a process of its own, and have one robot fail on the second side."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

from websockets.exceptions import ConnectionClosed

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.recording import RunFolder
from tests.operate.foxglove.viewer import Viewer
from tests.standards.ends import Ends, Place, open_ends
from tests.unit.plugins.ros2.rig import free_port, wait_for

RUN_S = 300.0
"""Real seconds that a run may take on a loaded machine."""


class Drive(NamedTuple):
    """The outcome of a run.

    Attributes:
        exit_code: of `eal run`.
        run: its record.
        starts: the true place of each robot before, in m.
        ends: the true place of each robot when it stands afterwards, in m.
        shown: the paths that a Foxglove viewer received, in m.
    """

    exit_code: int
    run: RunFolder
    starts: dict[str, Place]
    ends: dict[str, Place]
    shown: dict[str, list[Place]]


def drive(folder: Path, failing: str, side_m: float) -> Drive:
    """Drive the squares.

    Args:
        folder: of the runs.
        failing: the robot that fails when it is in the middle of its second side.
        side_m: length of a side.
    """
    with tempfile.TemporaryDirectory() as scratch, open_ends(Path(scratch)) as ends:
        starts = {name: end.place() for name, end in ends.robots.items()}
        port = free_port()
        command = ["run", "scenarios/standards.yaml", "--fleet", "fleets/standards.yaml", "--set", f"side_m={side_m}"]
        process = subprocess.Popen(
            [sys.executable, "-m", "eal_actors", *command, "--runs-dir", str(folder), "--foxglove", str(port)],
            cwd=bundled_path("."),
            env={**os.environ, **ends.variables},
        )
        try:
            shown = _watch(process, ends, failing, port, starts[failing][1] + side_m / 2)
            code = process.wait(RUN_S)
        finally:
            process.kill()
            process.wait()
        for name, end in ends.robots.items():
            wait_for(end.stands, f"{name} does not stand after the run")
        after = {name: end.place() for name, end in ends.robots.items()}
    run = max(folder.glob("standards-*"))  # by its time
    return Drive(code, RunFolder.open(run), starts, after, shown)


def _watch(
    process: subprocess.Popen[bytes], ends: Ends, failing: str, port: int, fails_at_y_m: float
) -> dict[str, list[Place]]:
    """View the run to its end, and let one robot fail on its way; return the paths in the view."""
    paths: dict[str, list[Place]] = {}
    end_s = REAL_TIME.now() + RUN_S
    try:
        with _open_viewer(process, port) as viewer:
            viewer.subscribe("/tf")
            has_failed = False
            for shown in viewer.messages():
                for one in shown.message["transforms"]:
                    place = one["translation"]["x"], one["translation"]["y"]
                    paths.setdefault(one["child_frame_id"].partition("/")[0], []).append(place)
                if not has_failed and ends.robots[failing].place()[1] > fails_at_y_m:
                    ends.robots[failing].fail()
                    has_failed = True
                if REAL_TIME.now() > end_s:
                    raise TimeoutError(f"the run has not ended after {RUN_S:g} s")
    except ConnectionClosed:  # the run has ended
        return paths
    return paths


def _open_viewer(process: subprocess.Popen[bytes], port: int) -> Viewer:
    viewers: list[Viewer] = []

    def has_opened() -> bool:
        assert process.poll() is None, f"the run has ended with exit code {process.returncode}"
        with contextlib.suppress(ConnectionRefusedError):
            viewers.append(Viewer(f"ws://127.0.0.1:{port}"))
        return bool(viewers)

    wait_for(has_opened, "the run serves no view")
    return viewers[0]
