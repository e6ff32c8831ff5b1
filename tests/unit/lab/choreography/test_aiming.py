"""Commands that lead a robot to a goal."""

from __future__ import annotations

import math

import pytest

from eal_actors.kernel.errors import UnavailableError
from eal_actors.lab.choreography.aiming import commands_to, drive_to, leg_commands, turn_command
from eal_actors.testing import Simulation


@pytest.mark.parametrize(
    ("yaw_deg", "to_deg", "command"),
    [(0, 90, "l90.0000"), (90, 0, "r90.0000"), (170, -170, "l20.0000"), (-170, 170, "r20.0000"), (10, 10, "r0.0000")],
)
def test_the_shorter_way_round(yaw_deg: float, to_deg: float, command: str) -> None:
    assert turn_command(math.radians(yaw_deg), math.radians(to_deg)) == command


def test_a_leg_ends_at_the_goal_or_before() -> None:
    assert leg_commands((1.0, 1.0, 0.0), (1.0, 3.0), 5.0) == ("l90.0000", "f2.0000")
    assert leg_commands((1.0, 1.0, 0.0), (1.0, 3.0), 0.5) == ("l90.0000", "f0.5000")


def test_a_robot_drives_to_a_goal_and_gives_up_after_so_many_legs() -> None:
    with Simulation({"scout": "roomba"}) as simulation:
        drive_to(simulation["scout"], (0.4, 0.3), 0.03)
        assert simulation.distance_m("scout", (0.4, 0.3)) <= 0.03
        assert list(commands_to(simulation["scout"], (0.4, 0.3), 0.03)) == []
        with pytest.raises(UnavailableError, match=r"did not reach \(-0.6, 0\) in 1 legs"):
            drive_to(simulation["scout"], (-0.6, 0.0), 0.01, longest_m=0.1, most_legs=1)
