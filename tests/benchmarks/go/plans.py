"""Traffic plans of 50 and 200 robots on 32 x 32 cells."""

from __future__ import annotations

import os
import time

from eal_actors.device.navigation.traffic.lacam import search
from eal_actors.device.navigation.traffic.planner import REFINE_WORK_EACH, SEARCH_WORK
from eal_actors.device.navigation.traffic.problem import cost_of
from eal_actors.device.navigation.traffic.refining import refine
from tests.benchmarks.result import Result
from tests.unit.device.navigation.traffic.floors import random_problem, violations

SEEDS = int(os.environ.get("GO_SEEDS", "20"))


def run() -> list[Result]:
    """Return the figures."""
    return [*_plans(50, 1.15), *_plans(200, 1.4)]


def _plans(count: int, most: float) -> list[Result]:
    ratios, processor_s = [], []
    for seed in range(SEEDS):
        problem = random_problem(32, 0.1, count, seed)
        begun_s = time.process_time()
        paths = refine(problem, search(problem, seed, SEARCH_WORK), seed, REFINE_WORK_EACH * count)
        processor_s.append(time.process_time() - begun_s)
        assert violations(problem, paths) == [], f"seed {seed}"
        ratios.append(cost_of(paths) / problem.least_cost)
    mean = sum(ratios) / SEEDS
    what = f"{count} robots planned on 32 x 32 cells, 10 % walls"
    return [
        Result(f"{what}: sum of costs", f"mean {mean:.3f}, most {max(ratios):.3f}", "shortest paths", mean, most),
        Result(f"{what}: valid", f"{len(ratios)} of {SEEDS}", "", len(ratios), SEEDS, "plans", at_least=True),
        Result(f"{what}: processor", f"mean {sum(processor_s) / SEEDS:.2f} s", "most", max(processor_s), 2.0, "s"),
    ]
