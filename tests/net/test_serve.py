"""`eal serve`: how it ends, and that it serves a robot that has failed."""

from __future__ import annotations

import os
import pty
import termios
from contextlib import ExitStack
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import DataError, ResourceFaultError, RobotFailedError
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, failure, ready
from tests.plugin_files import write_plugin
from tests.program import eal_processes


def test_it_ends_at_sigterm_while_its_terminal_is_paused(tmp_path: Path) -> None:
    """As by Ctrl-S: what it prints blocked it for good."""
    rig = Rig(tmp_path)
    with ExitStack() as stack:
        ends = pty.openpty()
        for end in ends:
            stack.callback(os.close, end)
        termios.tcflow(ends[1], termios.TCOOFF)
        start = stack.enter_context(eal_processes(tmp_path))
        arguments = "serve", "--fleet", rig.file, "--robot", "r1"
        server = start(*arguments, environment=os.environ, stdout=ends[1])
        stack.enter_context(ready(Fleet(rig.config)))
        server.terminate()
        assert server.wait(WAIT_S) == 0


def test_a_robot_that_has_failed_is_served_with_the_reason(tmp_path: Path) -> None:
    rig = Rig(tmp_path, extra={"defaults": {"max_restarts": 0}})
    with rig.served_here() as fleet:
        robot = fleet["r1"]
        failure(robot["Arm"].send_cmd("crash"), ResourceFaultError)
        assert eventually(lambda: robot.ping().get(timeout=WAIT_S).state is RobotState.FAILED)
        assert "stopped safely after more than 0 restarts" in str(failure(robot["Arm"].get_value(), RobotFailedError))
        assert rig.notes("halt")


def test_a_robot_that_fits_no_handshake_is_refused(tmp_path: Path) -> None:
    """Each controller refused it; `eal serve` said nothing."""
    code = "from eal_actors.plugin import EALPlugin, Resource\nclass Lamp(Resource):\n    __doc__ = 'x' * 2**20\n"
    write_plugin(tmp_path, "lamp", code, "Lamp")
    rig = Rig(tmp_path)
    rig.content["plugin_dirs"] = ["plugins"]
    rig.content["robots"]["r1"]["plugins"] = {"lamp": {}}
    rig.write()
    with pytest.raises(DataError, match="r1: cannot be served: the information of its resources"):
        RobotService(rig.config, "r1").open()
