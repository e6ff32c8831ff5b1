"""A ring that falls into two parts is connected by the shift that stands out most."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eal_actors.lab.panorama import stitch
from eal_actors.lab.panorama.cylinder import Shift
from eal_actors.lab.panorama.gaps import link_across_gap
from eal_actors.lab.panorama.gradients import DoubtfulShift
from eal_actors.lab.panorama.ring import Ring, ring_of
from tests.benchmarks.panorama import CASES
from tests.unit.lab.panorama import turning
from tests.unit.plugins.sim.ray_caster import psnr_db

Pair = tuple[int, int]


def shift(right_px: float) -> Shift:
    return Shift(right_px, np.zeros((1, 2)), np.zeros((1, 2)), "features", 1.0)


def ring(frames: int = 8, view_deg: float = 60) -> Ring:
    return ring_of({n: -math.radians(45 * n) for n in range(frames)}, math.radians(view_deg))


def links(gaps: set[Pair]) -> dict[Pair, Shift]:
    pairs = [(n, (n + 1) % 8) for n in range(8)]
    return {pair: shift(100.0) for pair in pairs if pair not in gaps}


def found(gaps: set[Pair], prominences: dict[Pair, float], of: Ring | None = None) -> dict[Pair, Shift]:
    def doubtful(one: int, other: int) -> DoubtfulShift | None:
        prominence = prominences.get((one, other))
        return None if prominence is None else DoubtfulShift(shift(90.0), prominence)

    return link_across_gap(of or ring(), links(gaps), doubtful)


@pytest.mark.parametrize(
    ("prominences", "expected"),
    [
        ({(3, 4): 0.3, (5, 6): 0.2}, [(3, 4)]),
        ({(3, 4): 0.1, (5, 6): 0.2}, [(5, 6)]),
        ({(5, 6): 0.2}, [(5, 6)]),
        ({}, []),
    ],
)
def test_the_clearer_of_two_doubtful_shifts_connects_the_parts(
    prominences: dict[Pair, float], expected: list[Pair]
) -> None:
    assert list(found({(3, 4), (5, 6)}, prominences)) == expected


@pytest.mark.parametrize(
    "gaps",
    [
        set(),
        {(3, 4)},  # the closed ring determines it
        {(3, 4), (4, 5)},  # nothing says that frame 4 belongs there
        {(1, 2), (3, 4), (5, 6)},
    ],
)
def test_other_gaps_are_left_to_odometry(gaps: set[Pair]) -> None:
    assert found(gaps, dict.fromkeys(gaps, 0.5)) == {}


def test_an_open_ring_has_no_other_way_round() -> None:
    gaps = {(3, 4), (5, 6)}
    assert found(gaps, dict.fromkeys(gaps, 0.5), ring(7)) == {}


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_robots_on_every_seam_leave_no_ghost(seed: int) -> None:
    case = CASES[-1]
    meant_rad = turning.steps()
    true_rad = turning.noisy(meant_rad, seed)
    panorama = stitch([case.frame(yaw, 640) for yaw in true_rad], meant_rad, math.radians(60))
    assert math.degrees(turning.yaw_error_rad(panorama, true_rad)) < 0.1
    movers = [robot for yaw in true_rad for robot in case.movers(yaw)]
    crowded = turning.truth(panorama, true_rad, movers=movers)
    assert psnr_db(panorama.image, crowded) > 25 or psnr_db(panorama.image, turning.truth(panorama, true_rad)) > 25
