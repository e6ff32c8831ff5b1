"""Measure the look-ahead: foretold contacts, false holds, and the processor time for ten robots.

A hold is false if, in the same run without it and without later holds, neither robot touches another one. The run
repeats to the bit, so this is no guess.

python -m tests.benchmarks.lookahead [--seeds 24] [--page docs/proving.md]
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from tempfile import TemporaryDirectory

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.lab.lookahead.forecast import ForeseenEvent
from eal_actors.lab.lookahead.script import Script, rehearse_scripts
from eal_actors.lab.lookahead.watching import Lookahead, LookaheadOptions
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Run, Scenario, load_scenario, make_plan
from tests.benchmarks.page import machine, write_between

MARK = "<!-- bench-lookahead -->"
ROBOTS = 10
MODELS = (("evbot2", 20), ("evbot3", 30))
"""The models of five robots each, and the first of their markers."""
LEAD_S, NOW_S, PATIENCE_S, AGAIN_S = 2.0, 1.0, 5.0, 10.0
Pair = frozenset[str]


@dataclass(frozen=True)
class Case:
    """A scenario, its fleet, and its rehearsal."""

    scenario: Scenario
    config: FleetConfig
    scripts: Mapping[str, Script]


@dataclass
class Observed:
    """The touches of two robots in a run, the looks that foresaw one, with their times, and the holds."""

    touches: list[tuple[Pair, float]] = field(default_factory=list)
    looks: list[tuple[Pair, float]] = field(default_factory=list)
    holds: list[tuple[float, ForeseenEvent]] = field(default_factory=list)
    duration_s: float = 0.0
    used_s: float = 0.0

    @property
    def contacts(self) -> list[tuple[Pair, float]]:
        """The touches, those of a pair within 10 s once."""
        found: list[tuple[Pair, float]] = []
        for pair, time_s in self.touches:
            if not any(pair == other and time_s - at_s < AGAIN_S for other, at_s in found):
                found.append((pair, time_s))
        return found


@dataclass
class Figures:
    """The figures of one kind of fleet, summed over the seeds."""

    touched: int = 0
    foretold: int = 0
    again: int = 0
    again_foretold: int = 0
    touched_held: int = 0
    holds: int = 0
    false: int = 0
    duration_s: float = 0.0
    used_s: float = 0.0

    def add(self, other: Figures) -> None:
        """Add the figures of a seed."""
        for one in fields(self):
            setattr(self, one.name, getattr(self, one.name) + getattr(other, one.name))

    @property
    def share(self) -> float:
        """The share of foretold contacts."""
        return self.foretold / max(1, self.touched)

    @property
    def rate(self) -> float:
        """False holds in 10 minutes."""
        return self.false * 600 / self.duration_s

    @property
    def is_good(self) -> bool:
        """Whether all goals are met."""
        return self.share >= 0.95 and self.rate <= 1 and self.used_s <= self.duration_s

    def rows(self) -> list[str]:
        """Return what was measured, in the order of `ROWS`."""
        every = self.touched + self.again, self.foretold + self.again_foretold
        return [
            f"{self.foretold} of {self.touched} ({self.share:.0%})",
            f"{every[1]} of {every[0]}",
            f"{self.rate:.1f} ({self.false} of {self.holds} holds, in {self.duration_s:.0f} s)",
            f"{self.touched_held} in place of {every[0]}",
            f"{self.used_s / self.duration_s:.2f}",
        ]


ROWS = (
    ("first contacts of two robots foretold at least 2 s before", "95 %"),
    ("later contacts included", ""),
    ("false holds in 10 minutes", "1"),
    ("contacts with holds", ""),
    ("processors for ten robots, simulation included", "1"),
)


def write_files(folder: Path, seed: int, *, is_tracked: bool) -> tuple[Path, Path]:
    """Write a scenario of random motions and its fleet, and return their files."""
    chosen = random.Random(seed)  # noqa: S311  # no secret
    robots, roles, branches = [], [], []
    for number in range(ROBOTS):
        x_m, y_m, yaw_deg = number % 5 * 1.3 - 2.6, number // 5 * 1.6 - 0.8, chosen.randrange(360)
        start = f"{{x_m: {x_m:.1f}, y_m: {y_m:.1f}, yaw_deg: {yaw_deg}}}"
        model, first = MODELS[number // 5]
        pose = f"pose: {{marker: {first + number % 5}}}, " if is_tracked else ""
        robots.append(f"  r{number}: {{type: {model}, tags: [t{number}], {pose}plugins: {{sim: {{start: {start}}}}}}}")
        roles.append(f"  p{number}: {{tags: [t{number}]}}")
        moves = []
        for _ in range(4):
            moves += [f"{chosen.choice('lr')}{chosen.randrange(20, 160)}", f"f{chosen.uniform(0.3, 1.0):.2f}"]
        branches.append(f"      - - on: p{number}\n          do:")
        branches += [f"            - send_cmd: {{resource: Base, cmd: {move}}}" for move in moves]
    fleet, scenario = folder / f"fleet-{seed}.yaml", folder / f"random-{seed}.yaml"
    types = "".join(f"  {model}: {{plugins: {{sim: {{model: {model}}}}}}}\n" for model, _ in MODELS)
    kind = f"include: [{bundled_path('fleets/ceiling.yaml')}]" if is_tracked else f"world: field\ntypes:\n{types}"
    head = f"version: 1\nname: ten\nseed: {seed}\nclock: {{rate: max}}\n{kind}"
    fleet.write_text("\n".join([head, "robots:", *robots, ""]))
    about = "version: 1\nname: random\ntimeout_s: 60\non_failure: skip\nroles:"
    scenario.write_text("\n".join([about, *roles, "steps:\n  - parallel:", *branches, ""]))
    return scenario, fleet


def make_case(folder: Path, seed: int, *, is_tracked: bool) -> Case:
    """Write the files of a seed, and rehearse the scenario."""
    scenario_file, fleet_file = write_files(folder, seed, is_tracked=is_tracked)
    scenario, config = load_scenario(scenario_file), EALConfigManager.load(fleet_file).fleet
    return Case(scenario, config, rehearse_scripts(scenario, simulated(config, config.robots)))


def observe(case: Case, most_holds: int) -> Observed:
    """Run a case at rate max; after a number of holds there are no more."""
    seen, names = Observed(), case.config.robots

    def keep(time_s: float, findings: Sequence[ForeseenEvent]) -> None:
        seen.looks.extend((pair_of(finding), time_s) for finding in findings if finding.other in names)

    def may_hold(time_s: float, finding: ForeseenEvent) -> bool:
        if len(seen.holds) >= most_holds:
            return False
        seen.holds.append((time_s, finding))
        return True

    with Fleet(case.config) as fleet:
        plan = make_plan(case.scenario, fleet)
        began_s, used_s = fleet.clock.now(), time.process_time()
        options = LookaheadOptions(holds=most_holds > 0)
        with Lookahead(fleet, plan.robots, case.scripts, options, keep, may_hold) as lookahead:
            Run(plan, fleet, None, [lookahead.hear]).start().get()
        seen.duration_s, seen.used_s = fleet.clock.now() - began_s, time.process_time() - used_s
        contacts = [contact for contact in fleet.services.contacts.copy() if contact.other in names]
        seen.touches = [(frozenset({contact.robot, contact.other}), contact.time_s) for contact in contacts]
    return seen


def pair_of(finding: ForeseenEvent) -> Pair:
    """Return the two robots of a contact."""
    return frozenset({finding.robot, str(finding.other)})


def judge(case: Case) -> Figures:
    """Run a case without holds, with holds, and once for each hold without it."""
    free, held = observe(case, 0), observe(case, 10**6)
    figures = Figures(duration_s=held.duration_s, used_s=held.used_s, holds=len(held.holds))
    figures.touched_held = len(held.contacts)
    for pair, time_s in free.contacts:
        in_time = any(pair == other and LEAD_S <= time_s - at_s <= AGAIN_S for other, at_s in free.looks)
        if any(other & pair and at_s < time_s for other, at_s in free.contacts):
            figures.again, figures.again_foretold = figures.again + 1, figures.again_foretold + in_time
        else:
            figures.touched, figures.foretold = figures.touched + 1, figures.foretold + in_time
    figures.false = sum(is_false(observe(case, number), *hold) for number, hold in enumerate(held.holds))
    return figures


def is_false(without: Observed, at_s: float, finding: ForeseenEvent) -> bool:
    """Return whether nothing was to be held, as the run without the hold shows."""
    robots = {finding.robot, finding.other}
    until_s = at_s + finding.in_s + PATIENCE_S
    return not any(pair & robots and at_s - NOW_S < time_s < until_s for pair, time_s in without.touches)


def main(arguments: list[str]) -> int:
    """Return 1 if a figure misses its goal."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.lookahead", description=__doc__)
    parser.add_argument("--seeds", type=int, default=24)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args(arguments)
    found = {"odometry alone": Figures(), "with a tracker": Figures()}
    with TemporaryDirectory() as folder:
        for seed in range(1, options.seeds + 1):
            for name, figures in found.items():
                one = judge(make_case(Path(folder), seed, is_tracked=name == "with a tracker"))
                figures.add(one)
                sys.stdout.write(f"seed {seed}, {name}: {'; '.join(one.rows())}\n")
    columns = zip(ROWS, *(figures.rows() for figures in found.values()), strict=True)
    lines = [f"| what | {' | '.join(found)} | goal |", "| --- | --- | --- | --- |"]
    lines += [f"| {what} | {' | '.join(measured)} | {goal} |" for (what, goal), *measured in columns]
    text = "\n".join([*lines, "", f"Seeds 1 to {options.seeds}, in lock step. Measured on {machine()}."])
    sys.stdout.write(f"{text}\n")
    if options.page is not None:
        write_between(options.page, MARK, text)
    return 0 if all(figures.is_good for figures in found.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
