"""Prove the thesis's scenarios, the other shipped ones and the planted bugs, and print the figures.

python -m tests.benchmarks.proof [SCENARIO[:FLEET]]... [--runs 250] [--others] [--planted] [--page docs/proving.md]

With named scenarios, only their rows of the page are replaced.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from eal_actors.kernel.bundled import bundled_path
from eal_actors.lab.proof import Proof, ProofRequest, prove
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario
from tests.benchmarks.page import machine, rows_between, write_between
from tests.proof.planted import PLANTED

THESIS = ("dance", "square", "panorama")
"""Tables 6.3, 6.1 and 6.2 of the thesis."""
OTHERS = (
    "relay:relay",
    "formation:formation",
    "patrol:patrol",
    "search:search",
    "standards:standards",
    "square-umbmark:uncalibrated",
    "inspect:sim",
    "ballet:formation",
)
SCENARIOS = (
    "what",
    "runs",
    "single faults",
    "done",
    "failed safely",
    "findings",
    "time",
    "processor time",
    "runs per second",
)
"""The processor time, of all processes, hardly depends on what else the machine does: a proof keeps all cores busy."""
BUGS = ("planted bug", "invariant", "runs", "findings", "least fleet", "trials to shrink it")
MARK, MARK_OF_BUGS = "<!-- bench-proof -->", "<!-- bench-proof-bugs -->"


def main(arguments: list[str]) -> int:
    """Return 1 if a scenario has a finding, or a planted bug was not found."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.proof", description=__doc__)
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="default: those of the thesis")
    parser.add_argument("--runs", type=int, default=250)
    parser.add_argument("--others", action="store_true", help="the other shipped scenarios as well")
    parser.add_argument("--planted", action="store_true", help="the planted bugs as well")
    parser.add_argument("--page", type=Path, help="the page to write the tables into")
    options = parser.parse_args(arguments)
    load = os.getloadavg()[0]
    names = options.scenarios or ([] if options.planted and not options.others else THESIS)
    proofs = [_of_scenario(name, options.runs) for name in names]
    if options.others:
        proofs += [_of_scenario(name, options.runs) for name in OTHERS]
    bugs = [_of_bug(number) for number in range(len(PLANTED))] if options.planted else []
    _show(SCENARIOS, [row for row, _ in proofs], options.page, MARK, load)
    _show(BUGS, [row for row, _ in bugs], options.page, MARK_OF_BUGS, load)
    return 0 if all(is_good for _, is_good in (*proofs, *bugs)) else 1


def _show(heads: Sequence[str], rows: Sequence[Sequence[str]], page: Path | None, mark: str, load: float) -> None:
    """Print a table, and replace its rows in a page."""
    if not rows:
        return
    former = rows_between(page, mark) if page is not None else []
    before = {row[0]: row for row in former if len(row) == len(heads)}
    table = _table(heads, list({**before, **{row[0]: row for row in rows}}.values()))
    text = f"{table}\n\nMeasured on {machine()}; when it began, other programs made a load of {load:.0f}."
    sys.stdout.write(f"{text}\n")
    if page is not None:
        write_between(page, mark, text)


def _of_scenario(named: str, runs: int) -> tuple[Sequence[str], bool]:
    name, _, fleet = named.partition(":")
    with TemporaryDirectory() as folder:
        config = EALConfigManager.load(bundled_path(f"fleets/{fleet or 'sim'}.yaml")).fleet
        scenario = load_scenario(bundled_path(f"scenarios/{name}.yaml"))
        began_s, used_s = time.perf_counter(), _processor_s()
        proof = prove(ProofRequest(scenario, config, Path(folder) / "proof", runs=runs, jobs=os.cpu_count() or 1))
        took_s, used_s = time.perf_counter() - began_s, _processor_s() - used_s
    count, safe = len(proof.cases), _count(proof, "failed") + _count(proof, "aborted") + _count(proof, "refused")
    row = (name, count, f"{proof.singles} of {proof.planned}", _count(proof, "done"), safe, len(proof.findings))
    return [*map(str, row), f"{took_s:.1f} s", f"{used_s:.1f} s", f"{count / took_s:.1f}"], proof.is_proven


def _processor_s() -> float:
    """Return the processor time of this process and of its workers that have ended."""
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def _count(proof: Proof, outcome: str) -> int:
    return sum(case.outcome == outcome and not case.violations for case in proof.cases)


def _of_bug(number: int) -> tuple[Sequence[str], bool]:
    bug = PLANTED[number]
    with TemporaryDirectory() as folder:
        scenario, fleet = bug.write(Path(folder))
        request = ProofRequest(
            load_scenario(scenario),
            EALConfigManager.load(fleet).fleet,
            Path(folder) / "proof",
            runs=60,
            jobs=os.cpu_count() or 1,
            kinds=bug.faults,
            within_s=bug.within_s,
        )
        proof = prove(request)
    found = [one.least for one in proof.findings if one.invariant == bug.invariant and one.least is not None]
    least = min(found, key=lambda one: one.size, default=None)
    size = "not found" if least is None else f"{least.size[0]} of 4 robots, {least.size[1]} fault(s)"
    trials = "" if least is None else str(least.trials)
    row = [bug.name.replace("-", " "), bug.invariant, str(len(proof.cases)), str(len(proof.findings)), size, trials]
    return row, least is not None and least.size == (bug.robots, 1 + bug.pair)


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(row) + " |" for row in (heads, ("---",) * len(heads), *rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
