"""A tracker and a robot on machines whose clocks are 10 s apart and jump by 5 s while the robot drives.

Each server's wall and monotonic clocks are shifted from the start of its process. The test and the tracker exchange
true poses by a file, with times of the machine's own clock, which nobody shifts.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from eal_actors import Fleet
from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.bundled import bundled_path
from tests.net.rig import WAIT_S, Process, Rig, ready
from tests.plugin_files import write_plugin

SHIFTED = """\
import os, time

SHIFT_S, JUMP = float(os.environ["SHIFT_S"]), os.environ["JUMP"]
wall, monotonic = time.time, time.monotonic


def shift_s():
    return SHIFT_S + (5.0 if os.path.exists(JUMP) else 0.0)


time.time = lambda: wall() + shift_s()
time.monotonic = lambda: monotonic() + shift_s()
"""
TRACKER = """
import json, time
from pathlib import Path
import numpy as np
from eal_actors.plugin import *


class Fixes(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(None, 13))

    def get_value(self):
        if not FILE.exists():
            return EALData.of(np.zeros((0, 13)), stamp_s=0.0)
        seen_s, pose = json.loads(FILE.read_text())
        age_s = time.clock_gettime(time.CLOCK_MONOTONIC) - seen_s
        row = [1.0, *pose, 1e-4, 0, 0, 0, 1e-4, 0, 0, 0, 1e-4]
        return EALData.of(np.array([row]), frame_id="map", stamp_s=CLOCK.now() - age_s)


def connect(context):
    global CLOCK, FILE
    CLOCK, FILE = context.services.clock, Path(__file__).parents[2] / "seen.json"
    return EALPlugin("Fixes")
"""
LATE = 4
"""So many readings of the true pose are newer than the one that is the fix."""
OFF_M = 0.05
"""Error of the estimate at the start of each drive."""
RIGHT_M = 0.02
"""At 0.3 m/s, a fix that is 0.1 s off is wrong by more."""


@contextmanager
def shifted(rig: Rig, robot: str, shift_s: float) -> Iterator[Process]:
    """Serve a robot in a process whose clocks are shifted, and jump when the file `jump-<robot>` is there."""
    folder = rig.folder / "shifted"
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(SHIFTED)
    path, jump = f"PYTHONPATH={folder}:{bundled_path('.')}", f"JUMP={rig.folder / f'jump-{robot}'}"
    command = ["-m", "eal_actors", "serve", "--fleet", str(rig.file), "--robot", robot]
    server = Process(command, rig.folder, within=["env", path, jump, f"SHIFT_S={shift_s}"])
    try:
        yield server.wait_until_listening()
    finally:
        server.end()


def drive_under(fleet: Fleet, robot: RobotHandle, folder: Path, command: str) -> list[float]:
    """Drive while late fixes arrive; return the errors of the estimate meanwhile, the last one at the end."""
    x_m, y_m, yaw_rad = robot["TruePose"].get_value().get().value
    robot.pose.set(x_m, y_m + OFF_M, math.degrees(yaw_rad)).get()
    drive: Future[int] = robot["Base"].send_cmd(command)
    seen: list[tuple[float, list[float]]] = []
    errors: list[float] = []
    end_s = fleet.clock.now() + WAIT_S
    while not drive.done() or (errors[-1] > RIGHT_M and fleet.clock.now() < end_s):
        true = robot["TruePose"].get_value().get()
        estimate = robot["Pose"].get_value().get().value
        errors.append(math.dist(true.value[:2], estimate[:2]))
        age_s = fleet.clock.now() - (true.stamp_s or 0.0)
        seen.append((time.clock_gettime(time.CLOCK_MONOTONIC) - age_s, np.array(true.value).tolist()))
        if len(seen) > LATE:
            trial = folder / "seen.new"
            trial.write_text(json.dumps(seen[-1 - LATE]))
            trial.replace(folder / "seen.json")
        fleet.clock.sleep(0.1)
    drive.get()
    return errors


JUMPS = (("", "f0.6"), ("eye", "b0.6"), ("r1", "f0.6"))
"""The robot whose clock jumps first, and the drive."""


@pytest.mark.parametrize("jumps", [JUMPS[:1], pytest.param(JUMPS, marks=pytest.mark.slow)], ids=["apart", "jumping"])
def test_fixes_keep_their_time_between_machines_whose_clocks_are_apart_and_jump(
    tmp_path: Path, jumps: tuple[tuple[str, str], ...]
) -> None:
    write_plugin(tmp_path, "late", TRACKER, "Fixes")
    rig = Rig(tmp_path, ("r1", "eye"), extra={"clock": {"rate": 1}})
    rig.content["plugin_dirs"] = [str(tmp_path / "plugins")]
    rig.content["robots"]["r1"] |= {
        "pose": {"from": ["odometry", "eye"], "marker": 1},
        "plugins": {"sim": {"model": "roomba", "noise": False, "start": {"x_m": -1.0, "y_m": 0.0}}},
    }
    rig.content["robots"]["eye"] |= {"plugins": {"late": {}}}
    rig.write()
    with ExitStack() as stack:
        stack.enter_context(shifted(rig, "r1", -5.0))
        stack.enter_context(shifted(rig, "eye", 5.0))
        fleet = stack.enter_context(ready(Fleet(rig.config)))
        robot = fleet["r1"]
        for late, command in jumps:
            (tmp_path / f"jump-{late}").touch()
            errors = drive_under(fleet, robot, tmp_path, command)
            assert errors[-1] < RIGHT_M, (late, errors)
            assert max(errors) < OFF_M + RIGHT_M, (late, errors)  # of 5 s, a fix would be 0.6 m off
