"""Late fixes of a tracker for a robot in another process, whose clock began at another time."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.data import EALData
from tests.net.late_fixes import FIXES
from tests.net.rig import Rig, becomes, servers
from tests.plugin_files import write_plugin

TRACKER = """
import numpy as np
from eal_actors.plugin import *
from tests.net.late_fixes import FIXES


class Fixes(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(None, 13))

    def get_value(self):
        return FIXES[-1] if FIXES else EALData.of(np.zeros((0, 13)), stamp_s=0.0)
"""
LATE = 4
"""So many readings of the true pose are newer than the one that is the fix."""
OFF_M = 0.03
"""Error of the start in the fleet file."""


def test_late_fixes_cross_the_network_at_their_own_time(tmp_path: Path) -> None:
    """The robot drives while fixes arrive late: by their arrival they would pull its pose back by many centimetres."""
    FIXES.clear()
    write_plugin(tmp_path, "late", TRACKER, "Fixes")
    pose = {"from": ["odometry", "eye"], "marker": 1, "start": {"x_m": -1.0, "y_m": OFF_M}}
    rig = Rig(tmp_path, extra={"clock": {"rate": 1}})
    rig.content["plugin_dirs"] = [str(tmp_path / "plugins")]
    rig.content["robots"]["r1"] |= {
        "pose": pose,
        "plugins": {"sim": {"model": "roomba", "noise": False, "start": {"x_m": -1.0, "y_m": 0.0}}},
    }
    rig.content["robots"]["eye"] = {"plugins": {"late": {}}}
    rig.write()
    covariance = np.diag([1e-4, 1e-4, 1e-4]).ravel()
    with servers(rig, "r1"), Fleet(rig.config) as fleet:
        robot = fleet["r1"]
        assert becomes(robot, RobotState.READY), robot.problems
        seen: list[EALData] = []
        drive = robot["Base"].send_cmd("f1.2")
        while not drive.done():
            seen.append(robot["TruePose"].get_value().get())
            if len(seen) > LATE:
                past = seen[-1 - LATE]
                row = np.array([[1.0, *past.value, *covariance]])
                FIXES.append(EALData.of(row, frame_id="map", stamp_s=past.stamp_s))
            fleet.clock.sleep(0.1)
        drive.get()
        truth = robot["TruePose"].get_value().get()
        estimate = np.array(robot["Pose"].send_req("estimate").get().value)
        assert math.hypot(*(estimate[:2] - truth.value[:2])) < OFF_M / 2, (estimate, truth)
        assert estimate[3] < 1e-4
