"""A long series of motions over noisy wires, in chunks that are kept: `make fuzz-motions` goes on where it was ended.

Each finished chunk is a line of a JSON lines file. A line counts as long as the driver's code and the judge's are those
that made it, so that a change of either begins its drivers anew.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, TextIO

from tests.fuzz.drivers import DRIVERS
from tests.fuzz.motions import MOTIONS_A_ROBOT, FuzzedDriver, fuzz

_ROOT: Final = Path(__file__).parents[2]
_JUDGE: Final = ("motions.py", "noisy_wire.py")
_BASED_ON: Final = {"evbot3": ("evbot2",)}
"""The plugins whose code a plugin uses too."""


@dataclass(frozen=True)
class Chunk:
    """The results of a driver's motions with the seeds of some robots.

    Attributes:
        driver: its name.
        code: of the driver and the judge.
        seed: of the first robot; the others have the next ones.
        answers: number of motions by answer.
        faults: number of damaged bytes.
        worst_m: greatest true error of an `ok`.
        worst_deg: greatest true error of an `ok`.
        wrong: what was wrong, each with its seed.
    """

    driver: str
    code: str
    seed: int
    answers: Mapping[str, int]
    faults: int
    worst_m: float
    worst_deg: float
    wrong: list[str]

    @property
    def motions(self) -> int:
        return sum(self.answers.values())


def code_of(driver: FuzzedDriver) -> str:
    """Return a digest of the driver's code and the judge's."""
    plugin = driver.plugin.__name__.split(".")[1]
    folders = [_ROOT / "plugins" / name for name in (plugin, *_BASED_ON.get(plugin, ()))]
    paths = [*(path for folder in folders for path in sorted(folder.glob("*.py")))]
    paths += [Path(__file__).parent / name for name in _JUDGE]
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in paths)).hexdigest()[:16]


def run_chunk(name: str, seed: int, motions: int) -> Chunk:
    """Move robots of a driver, the first with `seed`."""
    table = fuzz(DRIVERS[name], motions, seed)
    wrong = [f"seed {seed}: {result}" for seed, result in table.wrong]
    counts = dict(table.answers), sum(table.faults.values())
    return Chunk(name, code_of(DRIVERS[name]), seed, *counts, table.worst_m, table.worst_deg, wrong)


def read(path: Path) -> list[Chunk]:
    """Return the chunks of a file that were made by the present code; none if there is no file."""
    lines = path.read_text().splitlines() if path.exists() else []
    chunks = [Chunk(**json.loads(line)) for line in lines]
    return [chunk for chunk in chunks if chunk.driver in DRIVERS and chunk.code == code_of(DRIVERS[chunk.driver])]


def missing(chunks: Iterable[Chunk], names: Iterable[str], motions: int, seed: int, size: int) -> list[tuple[str, int]]:
    """Return the driver and the first seed of each chunk that is still to be run, drivers by turns."""
    done = {(chunk.driver, chunk.seed) for chunk in chunks}
    seeds = range(seed, seed + motions // MOTIONS_A_ROBOT, size // MOTIONS_A_ROBOT)
    return [(name, first) for first in seeds for name in names if (name, first) not in done]


def table_of(chunks: Iterable[Chunk]) -> str:
    """Return a line for each driver."""
    by_driver: dict[str, list[Chunk]] = {}
    for chunk in chunks:
        by_driver.setdefault(chunk.driver, []).append(chunk)
    return "\n".join(_row(name, by_driver[name]) for name in DRIVERS if name in by_driver)


def _row(name: str, chunks: list[Chunk]) -> str:
    answers = sum((Counter(chunk.answers) for chunk in chunks), Counter[str]())
    counts = ", ".join(f"{answer} {number:,}" for answer, number in answers.most_common())
    worst_cm = 100 * max(chunk.worst_m for chunk in chunks)
    worst_deg = max(chunk.worst_deg for chunk in chunks)
    return (
        f"{name}: {answers.total():,} motions, {sum(chunk.faults for chunk in chunks):,} faults: {counts}; "
        f"worst ok {worst_cm:.1f} cm {worst_deg:.1f} deg; wrong: {sum(len(chunk.wrong) for chunk in chunks)}"
    )


def run(todo: Iterable[tuple[str, int]], size: int, processes: int, out: TextIO) -> list[Chunk]:
    """Run chunks, and append each to a file when it is done."""
    chunks = []
    with ProcessPoolExecutor(processes) as pool:
        futures = [pool.submit(run_chunk, name, seed, size) for name, seed in todo]
        for future in as_completed(futures):
            chunks.append(chunk := future.result())
            out.write(json.dumps(asdict(chunk)) + "\n")
            out.flush()
            sys.stdout.write("".join(f"{chunk.driver}, {text}\n" for text in chunk.wrong))
    return chunks


def main(arguments: list[str] | None = None) -> int:
    """Return 1 if anything was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz.series", description=__doc__)
    parser.add_argument("drivers", nargs="*", metavar="DRIVER", help=f"of {', '.join(DRIVERS)}; all if none is given")
    parser.add_argument("--motions", type=int, default=10_000, help="of each driver")
    parser.add_argument("--size", type=int, default=250, help="motions of a chunk")
    parser.add_argument("--seed", type=int, default=1, help="of the first robot")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=_ROOT / "build/fuzz-motions.jsonl", help="keeps the chunks")
    given = parser.parse_args(arguments)
    if unknown := set(given.drivers) - set(DRIVERS):
        parser.error(f"there is no driver {', '.join(sorted(unknown))}")
    return _series(given)


def _series(given: Any) -> int:
    names = given.drivers or list(DRIVERS)
    kept = [chunk for chunk in read(given.out) if chunk.driver in names]
    todo = missing(kept, names, given.motions, given.seed, given.size)
    sys.stdout.write(f"{len(kept)} chunks are kept in {given.out}, {len(todo)} are to be run\n")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    with given.out.open("a") as out:
        chunks = [*kept, *run(todo, given.size, given.processes, out)]
    sys.stdout.write(table_of(chunks) + "\n")
    return int(any(chunk.wrong for chunk in chunks))


if __name__ == "__main__":
    sys.exit(main())
