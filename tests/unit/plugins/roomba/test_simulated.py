"""plugins/roomba: the same driver drives a simulated robot, through its wire protocol."""

from __future__ import annotations

import math
from typing import Any

import pytest

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import BlockedError, PluginError, ResourceFaultError
from eal_actors.plugin import FleetServices, PluginContext
from plugins.roomba import plugin, sci
from plugins.roomba.base import RoombaBase
from plugins.roomba.resources import RoombaBattery, RoombaBump, RoombaCliff, RoombaOdometry
from tests.manual_clock import HurriedClock
from tests.unit.plugins.roomba.rig import SimulatedRig


def arena(**things: Any) -> WorldModel:
    return WorldModel.model_validate({"version": 1, "name": "arena", "size_m": (6.0, 4.0), **things})


@pytest.mark.parametrize("protocol", ["sci", "oi"])
def test_it_drives_a_square_and_tracks_its_pose(protocol: str) -> None:
    rig = SimulatedRig(arena(), protocol)
    assert isinstance(rig.base, RoombaBase)
    assert rig.roomba.wheelbase_m == sci.WHEELBASE_M
    start_x_m, start_y_m, start_yaw_rad = rig.pose
    rig.do(*["f0.5", "l90"] * 4)
    x_m, y_m, yaw_rad = rig.pose
    assert math.hypot(x_m - start_x_m, y_m - start_y_m) < 0.1
    assert yaw_rad - start_yaw_rad == pytest.approx(2 * math.pi, abs=0.2)
    assert RoombaOdometry(rig.roomba).get_value().value == pytest.approx([0.0, 0.0, 0.0], abs=0.1)
    assert 0.9 < RoombaBattery(rig.roomba).get_value().value <= 1.0


def test_a_wall_presses_its_bumpers() -> None:
    rig = SimulatedRig(arena())
    with pytest.raises(BlockedError, match="something holds it"):
        rig.run(rig.base.send_cmd("f5"))
    assert RoombaBump(rig.roomba).get_value().value is True


@pytest.mark.parametrize("mode", ["safe", "full"])
def test_it_stops_at_a_drop_and_backs_off(mode: str) -> None:
    rig = SimulatedRig(arena(drops=({"x_m": 2.0, "y_m": 0.0, "size_m": (1.0, 3.9)},)), mode=mode)
    with pytest.raises(ResourceFaultError, match="halted: cliff"):
        rig.run(rig.base.send_cmd("f5"))
    rig.wait(1.0)
    edge_m = rig.pose[0]
    assert 1.2 < edge_m < 1.45
    assert RoombaCliff(rig.roomba).get_value().value is True
    rig.do("b0.3", "l180", "f0.5")
    assert rig.pose[0] < edge_m - 0.6
    assert RoombaCliff(rig.roomba).get_value().value is False


def test_without_a_simulation_there_is_no_simulated_port() -> None:
    settings = plugin.Settings.model_validate({"protocol": "sci", "link": "sim", "port": "sim://world/rob"})
    context = PluginContext("rob", "roomba", settings, FleetServices(HurriedClock()))
    with pytest.raises(PluginError, match="no simulated ports here"):
        plugin.connect(context)
