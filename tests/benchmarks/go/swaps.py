"""Twenty robots that swap places in 6 x 6 m, without and with mishaps."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

from tests.benchmarks.result import Result
from tests.traffic.rig import Mishaps, swap, travelling

SEEDS = int(os.environ.get("GO_SEEDS", "20"))
ROBOTS = 20


class SwapFigures(NamedTuple):
    """The outcome of one swap."""

    seed: int
    arrived: int
    gap_m: float
    duration_s: float
    stops: int


def run() -> list[Result]:
    """Return the figures."""
    return [*_swaps(with_mishaps=False), *_swaps(with_mishaps=True)]


def _swaps(*, with_mishaps: bool) -> list[Result]:
    with ProcessPoolExecutor(2, get_context("spawn")) as processes:
        figures = list(processes.map(swap_with_mishaps if with_mishaps else swap_places, range(SEEDS)))
    for figure in figures:
        print(figure)  # noqa: T201
    what = f"{ROBOTS} robots swap places" + (", with random stops and one killed" if with_mishaps else "")
    due = ROBOTS - 1 if with_mishaps else ROBOTS
    whole = sum(figure.arrived == due for figure in figures)
    gap_mm = min(figure.gap_m for figure in figures) * 1000
    touched = sum(figure.gap_m <= 0 for figure in figures)
    times_s = sorted(figure.duration_s for figure in figures)
    stops = sum(figure.stops for figure in figures)
    return [
        Result(
            f"{what}: all arrive", f"{whole} of {SEEDS} seeds, {stops} stops", "", whole, SEEDS, "seeds", at_least=True
        ),
        Result(f"{what}: collisions", f"least gap {gap_mm:.0f} mm", "true hulls, each 50 ms", touched, 0, "seeds"),
        Result(f"{what}: time", f"median {times_s[SEEDS // 2]:.0f} s", "most", times_s[-1], 600, "s"),
    ]


def swap_places(seed: int) -> SwapFigures:
    """Let the robots swap places."""
    return _swap(seed, with_mishaps=False)


def swap_with_mishaps(seed: int) -> SwapFigures:
    """Let the robots swap places; some stop, some are slow, and one is killed on its way."""
    return _swap(seed, with_mishaps=True)


def _swap(seed: int, *, with_mishaps: bool) -> SwapFigures:
    starts, goals, world = swap(ROBOTS, seed)
    with travelling(starts, world, seed) as watch:
        mishaps = Mishaps(watch, seed) if with_mishaps else None
        journey = watch.simulation.fleet.go_to(goals)

        def is_over() -> bool:
            if mishaps is not None:
                mishaps.happen()
            return journey.done()

        watch.until(is_over)
        arrived = sum(
            arrival.exception() is None and watch.distance_m(name, goals[name]) < 0.02
            for name, arrival in journey.arrivals.items()
        )
        stops = mishaps.stops if mishaps is not None else 0
        return SwapFigures(seed, arrived, watch.least_gap_m, watch.simulation.now_s, stops)
