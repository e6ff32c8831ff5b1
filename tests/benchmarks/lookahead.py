"""Measure the look-ahead: foretold contacts, false holds, and the processor time for ten robots.

python -m tests.benchmarks.lookahead [--seeds 10] [--page docs/proving.md]
"""

from __future__ import annotations

import argparse
import random
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from eal_actors.facade.fleet import Fleet
from eal_actors.lab.lookahead import ForeseenEvent, Lookahead, rehearse_scripts
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Run, load_scenario, make_plan
from tests.benchmarks.page import machine, write_between

MARK = "<!-- bench-lookahead -->"
ROBOTS = 10
LEAD_S, HOLD_S, PATIENCE_S, AGAIN_S = 2.0, 3.0, 5.0, 10.0
Contact = tuple[frozenset[str], float]


def write_files(folder: Path, seed: int) -> tuple[Path, Path]:
    """Write a scenario of random motions and its fleet, and return their files."""
    chosen = random.Random(seed)  # noqa: S311  # no secret
    robots, roles, branches = [], [], []
    for number in range(ROBOTS):
        x_m, y_m, yaw_deg = number % 5 * 1.3 - 2.6, number // 5 * 1.6 - 0.8, chosen.randrange(360)
        start = f"{{x_m: {x_m:.1f}, y_m: {y_m:.1f}, yaw_deg: {yaw_deg}}}"
        robots.append(f"  r{number}: {{type: mover, tags: [t{number}], plugins: {{sim: {{start: {start}}}}}}}")
        roles.append(f"  p{number}: {{tags: [t{number}]}}")
        moves = []
        for _ in range(4):
            moves += [f"{chosen.choice('lr')}{chosen.randrange(20, 160)}", f"f{chosen.uniform(0.3, 1.0):.2f}"]
        branches.append(f"      - - on: p{number}\n          do:")
        branches += [f"            - send_cmd: {{resource: Base, cmd: {move}}}" for move in moves]
    fleet, scenario = folder / f"fleet-{seed}.yaml", folder / f"random-{seed}.yaml"
    head = f"version: 1\nname: ten\nseed: {seed}\nclock: {{rate: max}}\nworld: field\n"
    fleet.write_text(
        "\n".join([f"{head}types:\n  mover: {{plugins: {{sim: {{model: evbot2}}}}}}\nrobots:", *robots, ""])
    )
    about = "version: 1\nname: random\ntimeout_s: 60\non_failure: skip\nroles:"
    scenario.write_text("\n".join([about, *roles, "steps:\n  - parallel:", *branches, ""]))
    return scenario, fleet


def measure(folder: Path, seed: int) -> tuple[list[Contact], list[tuple[float, ForeseenEvent]], float, float]:
    """Return contacts, findings, duration by the fleet's clock and processor time of one run at rate max."""
    scenario_file, fleet_file = write_files(folder, seed)
    scenario, config = load_scenario(scenario_file), EALConfigManager.load(fleet_file).fleet
    scripts = rehearse_scripts(scenario, simulated(config, config.robots))
    looks: list[tuple[float, ForeseenEvent]] = []

    def keep(time_s: float, findings: Sequence[ForeseenEvent]) -> None:
        looks.extend((time_s, finding) for finding in findings if finding.other in config.robots)

    with Fleet(config) as fleet:
        plan = make_plan(scenario, fleet)
        began_s, used_s = fleet.clock.now(), time.process_time()
        with Lookahead(fleet, plan.robots, scripts, on_look=keep) as lookahead:
            Run(plan, fleet, None, [lookahead.hear]).start().get()
        duration_s, used_s = fleet.clock.now() - began_s, time.process_time() - used_s
        contacts: list[Contact] = []
        for contact in fleet.services.contacts.copy():
            pair = frozenset({contact.robot, contact.other})
            is_known = any(pair == other and contact.time_s - at_s < AGAIN_S for other, at_s in contacts)
            if contact.other in config.robots and not is_known:
                contacts.append((pair, contact.time_s))
    return contacts, looks, duration_s, used_s


def judge(contacts: Sequence[Contact], looks: Sequence[tuple[float, ForeseenEvent]]) -> tuple[int, int]:
    """Return how many contacts were foretold in time, and the number of false holds; a pair's of 10 s count once."""
    pairs = [(frozenset({found.robot, str(found.other)}), at_s, found.in_s) for at_s, found in looks]
    foretold = sum(
        any(pair == other and LEAD_S <= time_s - at_s <= AGAIN_S for other, at_s, _ in pairs)
        for pair, time_s in contacts
    )
    false: dict[frozenset[str], float] = {}
    count = 0
    for pair, at_s, in_s in pairs:
        if in_s > HOLD_S or any(
            pair == other and -AGAIN_S <= time_s - at_s <= PATIENCE_S for other, time_s in contacts
        ):
            continue
        if at_s - false.get(pair, -AGAIN_S) >= AGAIN_S:
            count += 1
            false[pair] = at_s
    return foretold, count


def main(arguments: list[str]) -> int:
    """Return 1 if a figure misses its goal."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.lookahead", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--page", type=Path)
    options = parser.parse_args(arguments)
    touched = foretold = false = 0
    all_s = used_s = 0.0
    with TemporaryDirectory() as folder:
        for seed in range(1, options.seeds + 1):
            contacts, looks, duration_s, work_s = measure(Path(folder), seed)
            in_time, wrong = judge(contacts, looks)
            sys.stdout.write(f"seed {seed}: {in_time} of {len(contacts)} foretold, {wrong} false, {duration_s:.0f} s\n")
            touched, foretold, false = touched + len(contacts), foretold + in_time, false + wrong
            all_s, used_s = all_s + duration_s, used_s + work_s
    share, rate = foretold / max(1, touched), false * 600 / all_s
    text = (
        "| what | measured | goal |\n| --- | --- | --- |\n"
        f"| contacts foretold at least 2 s before | {foretold} of {touched} ({share:.0%}) | 95 % |\n"
        f"| false holds in 10 minutes | {rate:.1f} ({false} in {all_s:.0f} s) | 1 |\n"
        f"| processors for ten robots, simulation included | {used_s / all_s:.2f} | 1 |\n\n"
        f"Seeds 1 to {options.seeds}, in lock step. Measured on {machine()}."
    )
    sys.stdout.write(f"{text}\n")
    if options.page is not None:
        write_between(options.page, MARK, text)
    return 0 if share >= 0.95 and rate <= 1 and used_s <= all_s else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
