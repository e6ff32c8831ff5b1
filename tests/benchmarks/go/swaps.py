"""Twenty robots that swap places in 6 x 6 m, without and with mishaps."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import NamedTuple

from tests.benchmarks.result import Result
from tests.traffic.rig import Mishaps, TravelWatch, swap, travelling

SEEDS = int(os.environ.get("GO_SEEDS", "20"))
ROBOTS = 20
ARRIVED_M = 0.02
NEAR_M = 0.05
"""Half the margin between hulls: what the planner leaves at a goal beside something that stands."""


class SwapFigures(NamedTuple):
    """The outcome of one swap.

    Attributes:
        late: the robots that did not arrive, without the killed one and those whose goals it covers.
    """

    seed: int
    late: tuple[str, ...]
    gap_m: float
    duration_s: float


def run() -> list[Result]:
    """Return the figures."""
    return [*_swaps(with_mishaps=False), *_swaps(with_mishaps=True)]


def _swaps(*, with_mishaps: bool) -> list[Result]:
    with ProcessPoolExecutor(2, get_context("spawn")) as processes:
        figures = list(processes.map(swap_with_mishaps if with_mishaps else swap_places, range(SEEDS)))
    for figure in figures:
        print(figure)  # noqa: T201
    return summary(figures, "random stops and one killed" if with_mishaps else "no mishaps")


def summary(figures: list[SwapFigures], mishaps: str) -> list[Result]:
    """Return the figures of all seeds."""
    what, seeds = f"{ROBOTS} robots swap places, {mishaps}", len(figures)
    whole = sum(not figure.late for figure in figures)
    gap_mm = min(figure.gap_m for figure in figures) * 1000
    touched = sum(figure.gap_m <= 0 for figure in figures)
    times_s = sorted(figure.duration_s for figure in figures)
    return [
        Result(f"{what}: all arrive", f"{whole} of {seeds} seeds", "", whole, seeds, "seeds", at_least=True),
        Result(f"{what}: collisions", f"least gap {gap_mm:.0f} mm", "true hulls, each 50 ms", touched, 0, "seeds"),
        Result(f"{what}: time", f"median {times_s[seeds // 2]:.0f} s", "most", times_s[-1], 600, "s"),
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
        killed = mishaps.killed if mishaps is not None else None
        late = tuple(
            name
            for name, arrival in journey.arrivals.items()
            if (arrival.exception() is not None or watch.distance_m(name, goals[name]) > ARRIVED_M)
            and not (killed is not None and covers(watch, killed, name, goals[name]))
        )
        return SwapFigures(seed, late, watch.least_gap_m, watch.simulation.now_s)


def covers(watch: TravelWatch, killed: str, name: str, goal: tuple[float, float]) -> bool:
    """Return whether a dead robot is so near a goal that another one cannot stand there."""
    return name == killed or watch.distance_m(killed, goal) < watch.radii_m[killed] + watch.radii_m[name] + NEAR_M
