"""A robot that is sent to a place ends there, by its true pose: simulated makes, and drivers at emulators."""

from __future__ import annotations

from random import Random

import pytest

from tests.motion.rig import DRIVERS, random_goal, tracked, worst

SIMULATED = ("sim-evbot2", "sim-evbot3", "sim-roomba")
KINDS = (*SIMULATED, *DRIVERS)
NEAR_M, NEAR_DEG = 0.01, 2.0


def drive(kind: str, seed: int, goals: int) -> list[tuple[float, float]]:
    """Send an uncalibrated robot to places, one after another; return the errors."""
    random, found = Random(seed), []  # noqa: S311
    with tracked(kind, seed, calibrated=False) as it:
        it.fix()
        for _ in range(goals):
            goal = random_goal(random)
            error = it.until_done(it.robot.base.go_to(*goal))
            assert error is None, f"seed {seed}: {goal}: {error}"
            found.append(it.errors(*goal))
    return found


def check(kind: str, seeds: range, goals: int) -> None:
    errors = [error for seed in seeds for error in drive(kind, seed, goals)]
    print(f"{kind}: {len(errors)} goals, worst {worst(errors)}")  # noqa: T201  # the figure
    assert all(off_m <= NEAR_M and off_deg <= NEAR_DEG for off_m, off_deg in errors), worst(errors)


@pytest.mark.parametrize("kind", ["sim-evbot2", "oi"])
def test_it_ends_within_a_centimetre_and_two_degrees(kind: str) -> None:
    check(kind, range(1), 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_it_ends_there_in_a_hundred_of_a_hundred(kind: str) -> None:
    check(kind, range(100, 120), 5)
