"""Changes of a fleet file while its robots are served and controlled over the network."""

from __future__ import annotations

import fcntl
import os
import pty
import signal
import subprocess
import sys
import termios
from pathlib import Path
from typing import NoReturn

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import ConfigError, RobotNotFoundError, UnavailableError
from eal_actors.managers.fleet_changes import FleetChanges
from eal_actors.wire.rpc.server.host import RobotHost
from tests.net.links import eventually, free_port
from tests.net.rig import WAIT_S, Rig, becomes, ready, serving
from tests.plugin_files import write_plugin


def test_robots_come_go_and_move_while_another_is_commanded(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2", "r3"))
    third = rig.content["robots"].pop("r3")
    rig.write()
    with serving(rig.file, "r1", "r2") as servers, ready(Fleet(rig.config)) as fleet:
        second, move = fleet["r2"], fleet["r1"]["Arm"].send_cmd("move60")
        assert rig.begun("move60")
        second["Arm"].send_cmd("step1").get()
        servers["r2"].kill()
        rig.content["robots"]["r2"]["address"] = f"tcp/127.0.0.1:{free_port()}"
        rig.content["robots"]["r3"] = third
        rig.write()
        with serving(rig.file, "r2", "r3"):
            assert fleet.reload() == FleetChanges(added=("r3",), restarted=("r2",))
            assert fleet["r2"] is second
            assert becomes(second, RobotState.READY), second.problems
            assert becomes(fleet["r3"], RobotState.READY), fleet["r3"].problems
            assert second["Arm"].send_cmd("step2").get() == 2
            assert fleet["r3"]["Arm"].send_cmd("step3").get() == 3
            del rig.content["robots"]["r2"]
            rig.write()
            assert fleet.reload() == FleetChanges(removed=("r2",))
            assert fleet["r3"]["Arm"].send_cmd("step4").get() == 4
            with pytest.raises(RobotNotFoundError):
                _ = fleet["r2"]
        assert not move.done()
        assert rig.notes("halt", "end", robot="r1") == []
        assert fleet["r1"]["Arm"].halt().get() == 1
    assert rig.never_twice()


def test_the_network_of_connected_robots_cannot_change(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    with rig.served_here() as fleet:
        rig.content["network"] = {"dead_man_s": 3.0}
        rig.write()
        with pytest.raises(
            ConfigError, match=r"f\.yaml:1:\d+: network: 'network' cannot change while the fleet is open"
        ):
            fleet.reload()
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1


def test_eal_serve_reloads_its_file_at_sighup(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    notes = rig.notes_file
    with serving(rig.file, "r1") as servers, ready(Fleet(rig.config)) as fleet:
        robot = fleet["r1"]
        assert robot["Arm"].send_cmd("step1").get() == 1
        rig.notes_file = tmp_path / "other.txt"
        rig.content["robots"]["r1"]["plugins"]["witness"]["file"] = str(rig.notes_file)
        rig.write()
        servers["r1"].signal(signal.SIGHUP)
        servers["r1"].wait_for("reloaded: restarted r1")
        assert eventually(lambda: not robot["Arm"].send_cmd("step2").exception())
        assert "2" in rig.steps()
        assert "step 2" not in notes.read_text()
        rig.content["robots"]["r1"] |= {"exclusive": ["Arm"], "address": f"tcp/127.0.0.1:{free_port()}"}
        rig.write()
        servers["r1"].signal(signal.SIGHUP)
        column = rig.file.read_text().index('"tcp/') + 1  # of the value; the file is one line
        servers["r1"].wait_for(
            f"f.yaml:1:{column}: robots.r1.address: 'address' cannot change while the robot is served; "
            "restart `eal serve`"
        )
        servers["r1"].wait_for("'exclusive' cannot change while the robot is served", "2 problems; nothing was done.")
        assert robot["Arm"].send_cmd("step3").get() == 3
        rig.file.write_text("{")
        servers["r1"].signal(signal.SIGHUP)
        servers["r1"].wait_for("f.yaml:1:2: not valid YAML")
        assert robot["Arm"].send_cmd("step4").get() == 4
        servers["r1"].signal(signal.SIGTERM)
        assert servers["r1"].wait() == 0
    assert rig.never_twice()


def test_a_service_of_a_robot_that_left_the_file_continues(tmp_path: Path) -> None:
    rig = Rig(tmp_path, ("r1", "r2"))
    with RobotService(rig.config, "r1") as service:
        del rig.content["robots"]["r1"]
        rig.write()
        with pytest.raises(
            ConfigError, match=r"f\.yaml:1:\d+: robots\.r1: robot 'r1' is served; end `eal serve` first"
        ):
            service.reload()
        assert service.robot["Arm"].send_cmd("step1").get() == 1


def test_a_robot_that_fits_no_handshake_any_more_is_served_as_it_was(tmp_path: Path) -> None:
    """Its service ended without an error, and `eal serve` with exit code 0."""
    rig = Rig(tmp_path)
    code = "from eal_actors.plugin import EALPlugin, Resource\nclass Lamp(Resource):\n    __doc__ = 'x' * 2**20\n"
    write_plugin(tmp_path, "lamp", code, "Lamp")
    rig.content["plugin_dirs"].append("plugins")
    rig.write()
    with serving(rig.file, "r1") as servers, ready(Fleet(rig.config)) as fleet:
        assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        rig.content["robots"]["r1"]["plugins"]["lamp"] = {}
        rig.write()
        servers["r1"].signal(signal.SIGHUP)
        servers["r1"].wait_for("r1: cannot be served: the information of its resources")
        servers["r1"].wait_for("The robot was restarted with the former settings.")
        assert eventually(lambda: not fleet["r1"]["Arm"].send_cmd("step2").exception())
        assert "Lamp" not in fleet["r1"]
        servers["r1"].signal(signal.SIGTERM)
        assert servers["r1"].wait() == 0


def test_a_service_ends_with_the_error_if_a_reload_cannot_serve_the_robot_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> NoReturn:
        raise UnavailableError("is served already, by somebody", robot="r1")

    rig = Rig(tmp_path)
    with RobotService(rig.config, "r1") as service:
        monkeypatch.setattr(RobotHost, "serve", refuse)
        rig.content["robots"]["r1"]["timeout_s"] = 1.0
        rig.write()
        with pytest.raises(UnavailableError, match="by somebody"):
            service.reload()
        with pytest.raises(UnavailableError, match="by somebody"):
            service.wait()


def test_eal_serve_ends_when_its_terminal_closes(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    master, slave = pty.openpty()
    arguments = [sys.executable, "-m", "eal_actors", "serve", "--fleet", str(rig.file), "--robot", "r1"]
    process = subprocess.Popen(
        arguments,
        stdin=slave,
        stdout=subprocess.PIPE,
        stderr=slave,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),  # makes it the session's terminal
    )
    os.close(slave)
    assert process.stdout is not None
    with process:
        for line in process.stdout:
            if "listening at" in line:
                break
        os.close(master)
        assert process.wait(WAIT_S) == 0
    assert rig.notes("halt")
