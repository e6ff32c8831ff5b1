"""Two fleets of the same name: a controller commands the robots of its own alone, and names the others."""

from __future__ import annotations

from pathlib import Path

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.network_model import IDENTITY_VARIABLE
from eal_actors.wire.rpc.client.broadcast import ask_robots
from eal_actors.wire.rpc.client.discovery import robots_at
from tests.net.rig import Rig, becomes, failure, process, ready


def test_another_fleets_robot_at_the_same_address_is_refused_by_name(tmp_path: Path) -> None:
    """Its commands were carried out: the name and the address of a fleet are those of any copy of its file."""
    rig = Rig(tmp_path, network={"identity": "hers"})
    with RobotService(rig.config, "r1"):
        mine = EALConfigManager.load(rig.file, environment={IDENTITY_VARIABLE: "mine"}).fleet
        with Fleet(mine) as fleet:
            assert becomes(fleet["r1"], RobotState.LOST)
            (problem,) = fleet["r1"].problems
            assert "robots of another fleet do: r1 of f (identity hers)" in problem.message
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


def test_eal_serve_makes_an_identity(tmp_path: Path) -> None:
    """It only suggested one."""
    rig = Rig(tmp_path, network={"lease_s": 2.0})
    former = rig.config
    command = ["-m", "eal_actors", "serve", "-f", str(rig.file), "-r", "r1", "--new-identity"]
    with process(command, tmp_path) as serving:
        serving.wait_for("fleet f, identity ")
        config = EALConfigManager.load(rig.file).fleet
        assert config.network.identity is not None
        assert config.network.lease_s == 2.0
        assert any(f"identity {config.network.identity}" in line for line in serving.lines)
        address = config.robots["r1"].address
        assert address is not None
        (found,) = robots_at(address)
        assert found.identity == config.network.identity
        with ready(Fleet(config)) as fleet:
            assert fleet["r1"]["Arm"].send_cmd("step1").get() == 1
        with Fleet(former) as fleet:  # as the file was before
            assert becomes(fleet["r1"], RobotState.LOST)
    with process(command, tmp_path) as serving:
        serving.wait_for("fleet f, identity ")
        assert EALConfigManager.load(rig.file).fleet.network.identity == config.network.identity
