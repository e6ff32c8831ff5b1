"""A ping of a robot in this process, and of one that is not there."""

from __future__ import annotations

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import Ping, RobotState
from eal_actors.kernel.errors import UnavailableError
from eal_actors.testing import Simulation
from tests.net.links import fleet_of, free_port


def test_a_robot_of_this_process_answers_at_once_while_it_moves() -> None:
    with Simulation({"a": {"model": "roomba"}}) as simulation:
        robot = simulation["a"]
        robot["Base"].send_cmd("f1")
        answer = robot.ping()
        assert answer.done()
        ping = answer.get()
        assert ping == Ping(RobotState.READY, ping.release, len(robot), running=ping.running)
        robot.stop("a dog").get()
        assert robot.ping().get().stopped == "a dog"
    assert robot.ping().get().state is RobotState.STOPPED


def test_the_ping_of_an_unreachable_robot_fails_without_delay() -> None:
    config = fleet_of({}, {"r": f"tcp/127.0.0.1:{free_port()}"})
    with Fleet(config).connect(timeout_s=0.0) as fleet, pytest.raises(UnavailableError, match="r: the robot did not"):
        fleet["r"].ping().get()
