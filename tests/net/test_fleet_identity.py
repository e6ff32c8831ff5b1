"""Two fleets of the same name: a controller commands the robots of its own alone, and names the others."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from structlog.testing import capture_logs

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.network_model import IDENTITY_VARIABLE
from eal_actors.wire.rpc.client.broadcast import ask_robots
from eal_actors.wire.rpc.client.discovery import robots_at
from tests.net.links import free_port
from tests.net.rig import PLUGINS, WAIT_S, Rig, becomes, failure, process, ready


def test_another_fleets_robot_at_the_same_address_is_refused_by_name(tmp_path: Path) -> None:
    """Its commands were carried out: the name and the address of a fleet are those of any copy of its file."""
    rig = Rig(tmp_path, network={"identity": "hers"})
    with RobotService(rig.config, "r1"):
        mine = EALConfigManager.load(rig.file, environment={IDENTITY_VARIABLE: "mine"}).fleet
        with Fleet(mine) as fleet:
            assert becomes(fleet["r1"], RobotState.LOST)
            (problem,) = fleet["r1"].problems
            assert (
                "robots of another fleet do, which only its own file commands: r1 of f (identity hers)"
                in problem.message
            )
            failure(fleet["r1"].stop("mine"), UnavailableError)
        outcomes: list[object] = []
        ask_robots(mine, ["r1"], "stop", ("mine",), on_result=lambda _, error: outcomes.append(error), timeout_s=1.0)
        assert [type(outcome) for outcome in outcomes] == [UnavailableError]
        assert not rig.notes("stop", "halt", "step")
        with ready(Fleet(rig.config)) as fleet:
            assert fleet["r1"].stopped_because is None
            assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1


def test_discovery_tells_fleets_of_one_name_apart(tmp_path: Path) -> None:
    rig = Rig(tmp_path, network={"identity": "hers"})
    with RobotService(rig.config, "r1"):
        address = rig.config.robots["r1"].address
        assert address is not None
        (found,) = robots_at(address)
        assert (found.fleet, found.identity, found.robot) == ("f", "hers", "r1")


def test_the_robots_of_two_labs_with_copies_of_one_file_obey_their_own_lab_alone(tmp_path: Path) -> None:
    """Robots that other machines reach were served without an identity, and obeyed every fleet of their name."""
    hers = two_robots(tmp_path / "hers")
    mine = shutil.copytree(hers.parent, tmp_path / "mine") / hers.name
    with process(serving(hers, "r1"), tmp_path) as one, process(serving(hers, "r2"), tmp_path) as other:
        for server in (one, other):  # the first one writes, the second one finds it
            server.wait_for("fleet f, identity id-")
        config = EALConfigManager.load(hers).fleet
        identity = config.network.identity
        assert identity is not None
        assert config.network.lease_s == 2.0
        assert "# the two of us" in hers.read_text()
        written = [line for line in (*one.lines, *other.lines) if "wrote identity" in line]
        assert written
        assert all(f"wrote identity {identity} into" in line for line in written)
        with ready(Fleet(config)) as fleet:
            for robot in ("r1", "r2"):
                assert fleet[robot]["Arm"].send_cmd("step1").get() == 1
        addresses = [robot.address for robot in config.robots.values() if robot.address is not None]
        found = [robot for address in addresses for robot in robots_at(address)]
        assert [(robot.fleet, robot.identity, robot.robot) for robot in found] == [
            ("f", identity, "r1"),
            ("f", identity, "r2"),
        ]
        with Fleet(EALConfigManager.load(mine).fleet) as fleet:  # a copy as it was before
            for robot in ("r1", "r2"):
                assert becomes(fleet[robot], RobotState.LOST)
                (problem,) = fleet[robot].problems
                assert f"{robot} of f (identity {identity})" in problem.message
                with pytest.raises(UnavailableError, match="which only its own file commands"):
                    fleet[robot]["Arm"].send_cmd("step2")
    steps = [line.split()[1:] for line in (tmp_path / "notes.txt").read_text().splitlines() if " step " in line]
    assert steps == [["r1", "step", "1"], ["r2", "step", "1"]]
    before = hers.read_text()
    with process(serving(hers, "r1"), tmp_path) as server:
        server.wait_for(f"fleet f, identity {identity}")
    assert hers.read_text() == before


def test_a_robot_that_everybody_reaches_is_not_served_without_an_identity(tmp_path: Path) -> None:
    file = two_robots(tmp_path / "hers")
    file.write_text(file.read_text().replace("network: {lease_s: 2.0}", "network: {}"))
    with process(serving(file, "r1"), tmp_path) as server:
        server.wait_for("other machines reach r1: set `identity` here, or $EAL_FLEET_IDENTITY")
        server.wait_for("network: cannot be changed automatically: add `identity: id-")
        assert server.wait() == ExitCode.BAD_INPUT


def test_a_robot_of_this_machine_alone_needs_no_identity(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    before = rig.file.read_text()
    with process(serving(rig.file, "r1"), tmp_path) as server:
        server.wait_for("no identity: programs of this machine with a fleet of this name command it")
    assert rig.file.read_text() == before


@pytest.mark.parametrize(("identity", "warnings"), [(None, 1), ("ours", 0)])
def test_a_service_that_everybody_reaches_warns_without_an_identity(
    tmp_path: Path, identity: str | None, warnings: int
) -> None:
    """Only `eal serve` asked for an identity: a service made in Python obeyed every fleet of its name in silence."""
    file = two_robots(tmp_path / "hers")
    config = EALConfigManager.load(file).fleet
    config = replace(config, network=replace(config.network, identity=identity))
    with capture_logs() as logs, RobotService(config, "r1"):
        pass
    assert [line["robot"] for line in logs if "neither an identity nor keys" in line["event"]] == ["r1"] * warnings


def serving(file: Path, robot: str) -> list[str]:
    return ["-m", "eal_actors", "serve", "--fleet", str(file), "--robot", robot]


def two_robots(folder: Path) -> Path:
    """Write the fleet file of two robots that listen to everybody."""
    folder.mkdir()
    robots = {}
    for name in ("r1", "r2"):
        port = free_port()
        plugins = {"witness": {"file": str(folder.parent / "notes.txt")}}
        place = {"address": f"tcp/127.0.0.1:{port}", "listen": f"tcp/0.0.0.0:{port}"}
        robots[name] = {**place, "timeout_s": WAIT_S, "plugins": plugins}
    content = {"plugin_dirs": [str(PLUGINS)], "robots": robots}
    file = folder / "f.yaml"
    file.write_text(f"version: 1\nname: f  # the two of us\nnetwork: {{lease_s: 2.0}}\n{yaml.safe_dump(content)}")
    return file
