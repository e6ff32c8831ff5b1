"""Motions over wires that damage bytes: what a driver answers is true, and nothing moves on.

`make fuzz-motions` runs the long form, `series.py`, and prints its table.
"""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from tests.fuzz.drivers import DRIVERS
from tests.fuzz.motions import FuzzedDriver, FuzzedRobot, FuzzTable, Motion, fuzz
from tests.fuzz.noisy_wire import Line, Noise

SEED = 1
LOSS = Noise(0.01, ("drop",))
SURVIVORS = {"roomba-sci-cable": 95, "roomba-oi-cable": 95, "roomba-sci-mote": 95}
"""Motions of 100 that survive at least. The others fail with an error, and the robot stands."""


def _polled(name: str, poll_hz: int) -> FuzzedDriver:
    return replace(DRIVERS[name], settings={**DRIVERS[name].settings, "poll_hz": poll_hz})


def _check(table: FuzzTable) -> None:
    print(table)  # noqa: T201  # the long form shows it
    assert not table.wrong, "\n".join([str(table), *(f"seed {seed}: {result}" for seed, result in table.wrong)])


@pytest.mark.parametrize("name", DRIVERS)
def test_without_faults_every_motion_arrives(name: str) -> None:
    table = fuzz(DRIVERS[name], 10, SEED, Noise())
    _check(table)
    assert table.answers == {"ok": 10}


@pytest.mark.parametrize("name", DRIVERS)
def test_damaged_bytes_never_become_a_wrong_motion(name: str) -> None:
    _check(fuzz(DRIVERS[name], 10, SEED))


@pytest.mark.parametrize("name", ["evbot2-cable", "roomba-sci-mote"])
def test_a_seed_repeats_its_motions(name: str) -> None:
    runs = []
    for _ in range(2):
        robot = FuzzedRobot(DRIVERS[name], SEED)
        robot.wait(0.3)
        robot.wire.noise = Noise(0.02)
        runs.append([robot.move(Motion("f0.3", distance_m=0.3)) for _ in range(2)])
        robot.close()
    assert runs[0] == runs[1]


@pytest.mark.parametrize(
    ("name", "poll_hz", "seed", "least"),
    [
        ("roomba-sci-cable", 50, 1002, 10),
        ("roomba-sci-mote", 20, 1007, 9),
        ("roomba-oi-cable", 30, 1009, 10),
    ],
)
def test_lost_bytes_become_neither_wrong_motions_nor_many_errors(
    name: str, poll_hz: int, seed: int, least: int
) -> None:
    table = fuzz(_polled(name, poll_hz), 10, seed, LOSS)
    _check(table)
    assert table.answers["ok"] >= least


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("poll_hz", [5, 10, 20, 30, 50])
@pytest.mark.parametrize(("name", "least"), SURVIVORS.items())
def test_most_motions_survive_the_loss_of_1_percent_of_the_bytes(name: str, least: int, poll_hz: int) -> None:
    table = fuzz(_polled(name, poll_hz), 100, 1000, LOSS)
    _check(table)
    assert table.answers["ok"] >= least


@pytest.mark.parametrize(("there_s", "back_s"), [(0.0, 0.24), (0.12, 0.12), (0.0, 0.6), (0.1, 0.9), (0.0, 1.0)])
def test_a_create_whose_answers_are_late_ends_at_its_goal(there_s: float, back_s: float) -> None:
    robot = FuzzedRobot(replace(DRIVERS["roomba-oi-cable"], line=Line(115200, there_s, back_s)), SEED)
    try:
        robot.wait(2.0)
        results = [
            robot.move(motion)
            for motion in (
                Motion("l45", angle_rad=math.pi / 4, deadline_s=30.0),
                Motion("r90", angle_rad=-math.pi / 2, deadline_s=30.0),
            )
        ]
    finally:
        robot.close()
    assert not [result for result in results if result.is_wrong or result.answer != "ok"]
