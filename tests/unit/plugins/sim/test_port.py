"""Simulated serial ports: a real driver speaks its wire protocol to a robot of the world."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import BlockedError, PluginError, ResourceFaultError, UnavailableError
from eal_actors.managers.config import EALConfigManager
from eal_actors.plugin import PluginContext
from eal_actors.testing import Simulation
from plugins.sim.port import SimVehicle

DRIVEN: dict[str, Mapping[str, Any]] = {
    "real": {"plugins": {"roomba": {"protocol": "sci", "port": "sim://world/body"}}}
}


def test_a_driver_drives_a_robot_of_the_world_through_its_wire_protocol() -> None:
    robots: dict[str, Mapping[str, Any]] = {
        **DRIVEN,
        "body": {"model": "roomba", "start": (-1.0, 0.0, 90), "noise": True},
    }
    with Simulation(robots) as simulation:
        real = simulation["real"]
        assert real["Base"].send_cmd("f0.5").get() == 1
        pose = simulation.pose("body")
        assert pose.x_m == pytest.approx(-1.0, abs=0.03)
        assert pose.y_m == pytest.approx(0.5, abs=0.03)
        assert real["Base"].send_cmd("r90").get() == 1
        assert simulation.pose("body").yaw_rad == pytest.approx(0.0, abs=0.08)
        x_m, y_m, yaw_rad = real["Odometry"].get_value().get().value
        assert math.hypot(x_m, y_m) == pytest.approx(0.5, abs=0.02)
        assert yaw_rad == pytest.approx(-math.pi / 2, abs=0.05)


def test_the_driver_feels_walls_and_drops_of_the_world() -> None:
    world = {"version": 1, "name": "edge", "size_m": (4, 2), "drops": ({"x_m": 1.0, "y_m": 0.0, "size_m": (0.6, 2.0)},)}
    with Simulation({**DRIVEN, "body": {"model": "roomba", "start": (-1.0, 0.0, 180)}}, world) as simulation:
        real = simulation["real"]
        assert not real["Bump"].get_value().get().value
        with pytest.raises(BlockedError, match="something holds it"):
            real["Base"].send_cmd("f1.5").get()  # into the wall
        assert simulation.pose("body").x_m == pytest.approx(-2.0 + 0.17, abs=0.005)
        simulation.advance(0.2)
        assert real["Bump"].get_value().get().value
    with Simulation({**DRIVEN, "body": {"model": "roomba", "start": (-1.0, 0.0, 0)}}, world) as simulation:
        real = simulation["real"]
        with pytest.raises(ResourceFaultError, match="cliff"):
            real["Base"].send_cmd("f3").get()
        assert simulation.pose("body").x_m < 0.85


class Probe:
    """The emulator of a sensor that tells the place of its robot."""

    def __init__(self, body: SimVehicle) -> None:
        self._body = body

    def feed(self, data: bytes, _now_s: float) -> bytes:
        return ",".join(f"{number:.2f}" for number in self._body.pose).encode() if data else b""


def test_the_body_of_an_emulator_has_its_true_pose() -> None:
    with Simulation({"body": {"model": "roomba", "start": (-1.0, 0.5, 90)}}) as simulation:
        context = PluginContext("mate", "probe", None, simulation.fleet.services)
        port = context.simulated_port("sim://world/body", "roomba", Probe)
        port.write(b"?")
        assert port.read(100) == b"-1.00,0.50,1.57"


@pytest.mark.parametrize(
    ("robots", "body"),
    [
        ({**DRIVEN, "body": {"model": "roomba", "start": (-1.0, 0.0)}}, "body"),
        ({"real": {"model": "roomba", "start": (-1.0, 0.0)}}, "real"),
    ],
    ids=["driver", "twin"],
)
def test_where_the_floor_ends_a_driver_and_its_twin_halt_alike(robots: dict[str, Any], body: str) -> None:
    drop = {"x_m": 0.3, "y_m": 0.0, "size_m": (0.6, 1.0)}
    with Simulation(robots, {"version": 1, "name": "edge", "size_m": (4, 2), "drops": (drop,)}) as simulation:
        base = simulation["real"]["Base"]
        with pytest.raises(ResourceFaultError, match=re.escape("halted: cliff (front left, front right)")):
            base.send_cmd("f3").get()
        assert simulation.pose(body).x_m == pytest.approx(-0.15, abs=0.03)
        simulation.advance(0.2)
        with pytest.raises(ResourceFaultError, match="halted: cliff"):
            base.send_cmd("g").get()
        with pytest.raises(ResourceFaultError, match="halted: cliff"):
            base.set_value([0.2, 0.0]).get()
        assert base.send_cmd("l10").get() == 1
        assert base.send_cmd("b0.3").get() == 1  # backing off is allowed
        assert simulation.pose(body).x_m == pytest.approx(-0.45, abs=0.03)
        base.set_config("twist_timeout_s", 2.0).get()
        with pytest.raises(ResourceFaultError, match="halted: cliff"):
            base.set_value([0.4, 0.0]).get()
        simulation.advance(0.1)
        stopped = simulation.pose(body)
        simulation.advance(1.0)
        assert simulation.pose(body) == stopped


@pytest.mark.parametrize("model", ["evbot2", "evbot3"])
def test_who_has_no_cliff_sensors_drives_on(model: str) -> None:
    world = {"version": 1, "name": "edge", "size_m": (4, 2), "drops": ({"x_m": 0.6, "y_m": 0.0, "size_m": (0.6, 0.6)},)}
    with Simulation({"blind": {"model": model, "start": (-0.5, 0.0)}}, world) as simulation:
        assert simulation["blind"]["Base"].send_cmd("f1.5", timeout_s=60).get() == 1
        assert simulation.pose("blind").x_m > 0.9


def test_a_dead_robot_is_silent_on_the_wire() -> None:
    with Simulation({**DRIVEN, "body": {"model": "roomba"}}) as simulation:
        assert not simulation["real"]["Bump"].get_value().get().value
        simulation.inject("body", dead=True)
        simulation.advance(2.0)
        with pytest.raises(UnavailableError):
            simulation["real"]["Bump"].get_value().get()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("sim://world/body/more", "has the form sim://world/<robot>"),
        ("sim://elsewhere/body", "has the form sim://world/<robot>"),
        ("sample://world/body", "makes no simulated ports"),
    ],
)
def test_a_port_that_cannot_be_is_refused(url: str, words: str) -> None:
    robots = {"real": {"plugins": {"roomba": {"protocol": "sci", "port": url}}}}
    fleet = Fleet(EALConfigManager.of({"version": 1, "clock": {"rate": "max"}, "robots": robots}).fleet)
    with fleet:
        problems = "; ".join(str(problem) for problem in fleet["real"].problems)
    assert words in problems or url.startswith("sample"), problems


def test_a_robot_of_another_make_is_refused() -> None:
    with pytest.raises((PluginError, UnavailableError, Exception), match="is a evbot2, not a roomba"):
        Simulation({"body": {"model": "evbot2"}, **DRIVEN}).open()


def test_the_port_is_in_no_file_of_the_driver() -> None:
    folder = Path(__file__).parents[4] / "plugins/roomba"
    assert not any("plugins.sim" in path.read_text() for path in folder.glob("*.py"))
