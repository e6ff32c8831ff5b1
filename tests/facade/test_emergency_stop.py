"""An emergency stop halts everything and holds until it is resumed."""

from __future__ import annotations

import pytest

from eal_actors.kernel.errors import PreemptedError, StoppedError
from eal_actors.testing import Simulation

ROBOTS = {"a": {"model": "roomba", "start": (-1, 0)}, "b": {"model": "evbot3", "start": (1, 0)}}


def test_a_stop_halts_motion_and_refuses_new_motion() -> None:
    with Simulation(ROBOTS) as simulation:
        drives = {name: robot["Base"].send_cmd("f1") for name, robot in simulation.fleet.items()}
        simulation.advance(1.0)
        simulation.fleet.stop("somebody is in the way").get()
        poses = {name: simulation.pose(name) for name in ROBOTS}
        for name, drive in drives.items():
            with pytest.raises(
                PreemptedError, match="halted: an emergency stop holds the robot: somebody is in the way"
            ):
                drive.get()
            with pytest.raises(StoppedError, match="somebody is in the way"):
                simulation[name]["Base"].send_cmd("f1").get()
            assert simulation[name].stopped_because == "somebody is in the way"
        simulation.advance(5.0)
        assert {name: simulation.pose(name) for name in ROBOTS} == poses


def test_a_stop_allows_readings_stops_and_settings() -> None:
    with Simulation(ROBOTS) as simulation:
        simulation["a"].stop().get()
        assert simulation["a"]["Base"].get_status().get() == 0
        assert simulation["a"]["Pose"].get_value().get().shape == (3,)
        assert simulation["a"]["Base"].send_cmd("s").get() == 1
        assert simulation["a"]["Base"].set_config("speed_m_s", 0.2).get() == 1
        assert simulation["b"].stopped_because is None
        assert simulation["b"]["Base"].send_cmd("f0.1").get() == 1


def test_a_resumed_robot_moves_only_on_a_new_command() -> None:
    with Simulation(ROBOTS) as simulation:
        simulation["a"]["Base"].send_cmd("f1")
        simulation.advance(0.5)
        simulation["a"].stop("first").get()
        simulation["a"].stop("second").get()
        assert simulation["a"].stopped_because == "first"
        pose = simulation.pose("a")
        simulation["a"].resume().get()
        simulation.advance(2.0)
        assert simulation.pose("a") == pose
        assert simulation["a"]["Base"].send_cmd("f0.1").get() == 1
        assert simulation.pose("a").x_m > pose.x_m
