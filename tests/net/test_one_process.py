"""Several robots of one process: `eal serve` with more than one robot, in one simulated world."""

from __future__ import annotations

import math
import signal
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService, serve_together
from eal_actors.kernel.errors import ConfigError, UnsupportedError
from tests.net.rig import Rig, becomes, process


def rig_of(folder: Path) -> Rig:
    """Return two simulated robots that face each other, 0.2 m apart."""
    rig = Rig(folder, ("r1", "r2"), extra={"clock": {"rate": 1}})
    for name, x_m, yaw_deg in (("r1", -0.3, 0), ("r2", 0.3, 180)):
        start = {"x_m": x_m, "y_m": 0.0, "yaw_deg": yaw_deg}
        rig.content["robots"][name]["plugins"] = {"sim": {"model": "roomba", "noise": False, "start": start}}
    rig.write()
    return rig


@pytest.mark.slow
def test_robots_of_one_process_meet_in_one_world(tmp_path: Path) -> None:
    rig = rig_of(tmp_path)
    command = ["-m", "eal_actors", "serve", "--fleet", str(rig.file), "-r", "r1", "-r", "r2"]
    with process(command, tmp_path) as server, Fleet(rig.config) as fleet:
        for name in ("r1", "r2"):
            server.wait_for(f"{name} serves")
            assert becomes(fleet[name], RobotState.READY), server.lines
        fleet["r1"]["Base"].send_cmd("f0.5").exception()  # it pushes against the other robot, or is stopped by it
        x_m, y_m, _ = fleet["r1"]["TruePose"].get_value().get().value
        assert math.hypot(x_m, y_m) < 0.29, "the other robot is in its way"
        server.signal(signal.SIGTERM)
        assert server.wait() == 0


def test_what_robots_of_one_process_cannot_do_is_refused(tmp_path: Path) -> None:
    rig = rig_of(tmp_path)
    with serve_together(rig.config, ["r1", "r2"]) as (one, other):
        assert one.endpoints != other.endpoints
        with pytest.raises(UnsupportedError, match="restart `eal serve`"):
            one.reload()
    with pytest.raises(ConfigError, match="has no address"), RobotService(rig.local(), "r1"):
        pass
