"""Search for findings for long: `make fuzz`. Guided by coverage where atheris is installed, else by chance alone.

A finding is kept in `corpus/<target>`, where every test run tries it again.
"""

from __future__ import annotations

import argparse
import importlib.util
import random
import subprocess
import sys
import traceback

from eal_actors.kernel.clock import SystemClock
from tests.fuzz.corpus import TARGETS, keep, mutated, seeds


def by_chance(target: str, seconds: float, seed: int) -> bool:
    """Try mutations; return whether all was well."""
    chance, known, clock, tried = random.Random(seed), seeds(target), SystemClock(), 0  # noqa: S311  # a test
    while clock.now() < seconds:
        data = mutated(chance.choice(known), chance.choice(known), chance)
        tried += 1
        try:
            TARGETS[target](data)
        except Exception:  # noqa: BLE001  # that is what is looked for
            traceback.print_exc()
            sys.stdout.write(f"{target}: a finding, kept as {keep(target, data)}\n")
            return False
    sys.stdout.write(f"{target}: {tried:,} inputs by chance, seed {seed}: nothing found\n")
    return True


def guided(target: str, seconds: float) -> bool:
    """Try what leads to code that was not reached before; return whether all was well."""
    arguments = [sys.executable, "-m", "tests.fuzz.guided", target, f"{seconds:.0f}"]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False, timeout=seconds * 3 + 300)
    if done.returncode:
        sys.stdout.write(done.stderr)
    else:
        count = done.stderr.partition("stat::number_of_executed_units:")[2].split()
        sys.stdout.write(f"{target}: {int(count[0]) if count else 0:,} inputs guided by coverage: nothing found\n")
    return done.returncode == 0


def main() -> int:
    """Return 1 if anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; all if none is given")
    parser.add_argument("--seconds", type=float, default=60.0, help="for each target")
    parser.add_argument("--seed", type=int, default=1, help="of what is done by chance")
    given = parser.parse_args()
    if unknown := set(given.targets) - set(TARGETS):
        parser.error(f"there is no target {', '.join(sorted(unknown))}")
    has_atheris = importlib.util.find_spec("atheris") is not None
    sys.stdout.write("" if has_atheris else "atheris is not installed: by chance, without looking at coverage\n")
    well = [
        guided(target, given.seconds) if has_atheris else by_chance(target, given.seconds, given.seed)
        for target in given.targets or TARGETS
    ]
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(main())
