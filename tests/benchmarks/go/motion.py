"""Motions of uncalibrated robots with fixes, simulated makes and drivers at emulators, judged by the true pose."""

from __future__ import annotations

import math
import os
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from multiprocessing import get_context

from tests.benchmarks.result import Result
from tests.motion.rig import tracked
from tests.motion.test_go_to import KINDS, drive

SEEDS, GOALS = int(os.environ.get("GO_SEEDS", "20")), 5


def run() -> list[Result]:
    """Return the figures."""
    results = []
    with ProcessPoolExecutor(2, get_context("spawn")) as processes:
        for kind in KINDS:
            found = processes.map(drive, repeat(kind), range(SEEDS), repeat(GOALS))
            results.append(_goals(kind, [error for errors in found for error in errors]))
            squares_mm = sorted(processes.map(square_mm, repeat(kind), range(SEEDS)))
            median = f"median {squares_mm[SEEDS // 2]:.1f} mm"
            what = f"{kind}: a square of 1 m ends off its start"
            results.append(Result(what, median, "most", squares_mm[-1], 10.0, "mm"))
    return results


def _goals(kind: str, errors: list[tuple[float, float]]) -> Result:
    good = sum(off_m <= 0.01 and off_deg <= 2.0 for off_m, off_deg in errors)
    worst = f"worst {max(m for m, _ in errors) * 1000:.1f} mm, {max(deg for _, deg in errors):.2f} deg"
    what = f"{kind}: go_to within 1 cm and 2 degrees"
    return Result(what, f"{good} of {len(errors)}", worst, good / len(errors), 1.0, "", at_least=True)


def square_mm(kind: str, seed: int) -> float:
    """Let an uncalibrated robot follow a square of 1 m; return how far from its start it ends, in mm."""
    with tracked(kind, seed, calibrated=False) as it:
        it.fix()
        x_m, y_m, _ = it.true_pose()
        side_x, side_y = (-1.0 if at > 0 else 1.0 for at in (x_m, y_m))  # towards the middle of the room
        corners = ((side_x, 0.0), (side_x, side_y), (0.0, side_y), (0.0, 0.0))
        error = it.until_done(it.robot.base.follow([(x_m + dx, y_m + dy) for dx, dy in corners]))
        assert error is None, f"{kind}, seed {seed}: {error}"
        return math.dist(it.true_pose()[:2], (x_m, y_m)) * 1000
