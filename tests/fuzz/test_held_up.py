"""A motion of a Roomba whose program is held up, as by SIGSTOP or a busy machine: the robot drives on meanwhile."""

from __future__ import annotations

import math

import pytest

from tests.fuzz.drivers import DRIVERS
from tests.fuzz.motions import FuzzedRobot, Motion

MOTIONS = [
    Motion("f0.3", distance_m=0.3, deadline_s=20.0),
    Motion("l90", angle_rad=math.pi / 2, deadline_s=20.0),
]


class HeldUpRobot(FuzzedRobot):
    """A robot whose driver does nothing at all for a while, once."""

    held_up: tuple[float, float] | None = None
    """When it begins in s, and how long it takes in s."""

    def _pass_until(self, until_s: float) -> None:
        super()._pass_until(until_s)
        if self.held_up is not None and self.clock.now() >= self.held_up[0]:
            duration_s, self.held_up = self.held_up[1], None
            self.clock.advance(duration_s)


def moved(name: str, motion: Motion, after_s: float, duration_s: float) -> tuple[str, str]:
    """Return the answer of a motion that was held up, and its message; an `ok` is true."""
    robot = HeldUpRobot(DRIVERS[name], 1)
    try:
        robot.wait(0.5)
        robot.held_up = robot.clock.now() + after_s, duration_s
        result = robot.move(motion)
    finally:
        robot.close()
    assert robot.held_up is None, "the motion had ended before"
    assert not result.is_wrong, result
    return result.answer, result.message


@pytest.mark.parametrize("motion", MOTIONS, ids=lambda motion: motion.command)
@pytest.mark.parametrize(
    ("name", "after_s", "duration_s"),
    [
        ("roomba-sci-cable", 0.0, 2.5),  # before it moves
        ("roomba-sci-cable", 0.6, 2.5),  # while it drives
        ("roomba-oi-cable", 0.6, 2.5),
        ("roomba-sci-mote", 0.5, 0.9),
    ],
)
def test_the_motion_ends_at_its_goal(name: str, motion: Motion, after_s: float, duration_s: float) -> None:
    assert moved(name, motion, after_s, duration_s) == ("ok", "")


@pytest.mark.parametrize("after_s", [1.2, 1.4, 1.6, 1.8])
def test_a_stop_is_awaited_for_as_long_as_the_program_looks(after_s: float) -> None:
    assert moved("roomba-sci-cable", MOTIONS[0], after_s, 1.6) == ("ok", "")


def test_what_the_motes_stopped_meanwhile_fails_with_the_reason() -> None:
    answer, message = moved("roomba-sci-mote", MOTIONS[0], 0.6, 2.5)
    assert answer == "resource_fault"
    assert "this program was held up for 2.5 s during the motion" in message
