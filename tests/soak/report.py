"""The report of a soak: checks, growth and counts."""

from __future__ import annotations

import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from tests.soak.checks import CHECKS
from tests.soak.history import merged, overlap_s
from tests.soak.programs import Sample
from tests.soak.run import CONTROLLERS, Outcome

MOST_THREADS: Final = 1
MOST_ENGINE_THREADS: Final = 8
MOST_FILES: Final = 8
MOST_MEMORY_BYTES: Final = 12_000_000
"""How much a process may grow between the first and the last third of a soak."""
_BAD_WORDS: Final = ("Traceback", "crashed", "a query failed", "was left behind", "is abandoned", "did not end in time")
_LATE_START: Final = "not all robots were ready for the warden in time: what grew afterwards is partly their start"
_SHOWN: Final = 5


@dataclass(frozen=True)
class Growth:
    """The growth of a process from the second sixth to the last third of a soak; medians."""

    name: str
    memory_bytes: int
    threads: int
    engine_threads: int
    files: int
    memory_at_end_bytes: int

    @classmethod
    def of(cls, name: str, samples: Sequence[Sample]) -> Growth:
        """Compare what was sampled."""
        early = samples[len(samples) // 6 : len(samples) // 3] or samples[:1]
        late = samples[2 * len(samples) // 3 :]

        def grown(what: str) -> int:
            first, last = (statistics.median(getattr(sample, what) for sample in part) for part in (early, late))
            return round(float(last - first))

        memory_bytes, threads, engine_threads, files = map(
            grown, ("memory_bytes", "threads", "engine_threads", "files")
        )
        return cls(name, memory_bytes, threads, engine_threads, files, samples[-1].memory_bytes)

    def problems(self) -> Iterator[str]:
        """Tell what grew too much."""
        if self.threads > MOST_THREADS:
            yield f"{self.name} has {self.threads} threads more"
        if self.engine_threads > MOST_ENGINE_THREADS:
            yield f"{self.name} has {self.engine_threads} threads of the network's engine more"
        if self.files > MOST_FILES:
            yield f"{self.name} has {self.files} open files more"
        if self.memory_bytes > MOST_MEMORY_BYTES:
            yield f"{self.name} takes {self.memory_bytes / 1e6:.1f} MB more"


@dataclass(frozen=True)
class Report:
    """The whole.

    Attributes:
        counts: how often what happened.
        growths: of the processes that were never killed.
        hungry_share: for which part of the time a process was ready to run and had no processor, of all on average.
        findings: what is wrong, by check; an empty list is good.
    """

    robots: int
    duration_s: float
    seed: int
    counts: dict[str, int]
    growths: list[Growth]
    hungry_share: float
    findings: dict[str, list[str]]

    @classmethod
    def of(cls, outcome: Outcome) -> Report:
        """Judge what a soak left."""
        growths = [Growth.of(name, samples) for name, samples in sorted(outcome.samples.items())]
        findings = {name: list(check(outcome.history)) for name, check in CHECKS.items()}
        findings["everybody finds together before the first fault"] = [] if outcome.is_started else [_LATE_START]
        findings["no growth of threads, files and memory"] = [
            problem for growth in growths for problem in growth.problems()
        ]
        findings["no shared memory is left"] = outcome.shared_left
        findings["all processes end as they should"] = outcome.exits
        findings["nothing unexpected in the logs"] = list(_bad_lines(outcome))
        plan = outcome.plan
        counts, hungry = _counts(outcome), _hungry_share(outcome)
        return cls(plan.robots, plan.duration_s, plan.seed, counts, growths, hungry, findings)

    @property
    def holds(self) -> bool:
        """Whether nothing is wrong."""
        return not any(self.findings.values())

    def to_dict(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"holds": self.holds, **asdict(self)}

    def lines(self) -> Iterator[str]:
        """Return it for people."""
        yield f"{self.robots} robots, {self.duration_s:.0f} s, seed {self.seed}"
        for what, count in self.counts.items():
            yield f"  {what:<44}{count:>9,}"
        yield f"  without a processor: {self.hungry_share:.1%} of the time of a process"
        for growth in self.growths:
            yield (
                f"  {growth.name:<12} memory {growth.memory_bytes / 1e6:+6.1f} MB of "
                f"{growth.memory_at_end_bytes / 1e6:.0f} MB, threads {growth.threads:+d}, "
                f"engine's {growth.engine_threads:+d}, files {growth.files:+d}"
            )
        for name, problems in self.findings.items():
            yield f"  {'ok    ' if not problems else 'BROKEN'}  {name}"
            yield from (f"            {problem}" for problem in problems[:_SHOWN])
            if len(problems) > _SHOWN:
                yield f"            and {len(problems) - _SHOWN} more"


def _counts(outcome: Outcome) -> dict[str, int]:
    history = outcome.history
    counts: Counter[str] = Counter()
    counts.update(f"fault: {fault.kind}" for fault in history.faults)
    counts.update(f"command: {command.outcome or 'its controller was killed'}" for command in history.commands.values())
    for life in history.lives.values():
        counts.update(f"robot seen as {state}" for _, _, state in life.states)
        counts["controllers that left and came back"] += len(life.leaves)
        counts.update({f"other: {what}": count for what, count in life.outcomes.items()})
    counts.update(f"noted: {note.event}" for notes in history.notes.values() for note in notes)
    words = "its controller is silent: halted"
    counts["dead-man's switch"] = sum(log.read_text(encoding="utf-8").count(words) for log in outcome.logs)
    return dict(sorted(counts.items()))


def _hungry_share(outcome: Outcome) -> float:
    """Return it for the time in which faults came: starting many processes at once is another matter."""
    plan, history = outcome.plan, outcome.history
    faults = history.end_s - plan.duration_s, history.end_s
    hungry_s = sum(overlap_s(faults, merged(spans)) for spans in history.hungry.values())
    return hungry_s / (plan.duration_s * (plan.robots + len(CONTROLLERS)))


def _bad_lines(outcome: Outcome) -> Iterable[str]:
    for log in outcome.logs:
        for line in log.read_text(encoding="utf-8").splitlines():
            if any(word in line for word in _BAD_WORDS):
                yield f"{log.stem}: {line[:200]}"


def tables(report: Mapping[str, Any]) -> str:
    """Return what a report says, in the form of `to_dict`, as tables of Markdown."""
    counts = report["counts"].items()
    kinds = {kind: [(what, n) for what, n in counts if what.startswith(kind)] for kind in ("fault: ", "command: ")}
    told = [
        f"{report['robots']} robots, {report['duration_s']:.0f} s, seed {report['seed']}: "
        + ("every claim holds." if report["holds"] else "**not every claim holds.**"),
        *(f"{name}: {', '.join(problems)}." for name, problems in report["findings"].items() if problems),
    ]
    told.append(f"A process was ready to run and had no processor for {report['hungry_share']:.1%} of the time.")
    for kind, entries in kinds.items():
        rows = [[what.removeprefix(kind), f"{n:,}"] for what, n in entries]
        told.append(_table([[kind.strip(": "), "times"], *rows]))
    rows = [["never killed", "memory grew by", "of", "own threads", "engine's threads", "files"]]
    for of in report["growths"]:
        sizes = f"{of['memory_bytes'] / 1e6:+.1f} MB", f"{of['memory_at_end_bytes'] / 1e6:.0f} MB"
        rows.append([of["name"], *sizes, *(f"{of[key]:+d}" for key in ("threads", "engine_threads", "files"))])
    return "\n\n".join([*told, _table(rows)])


def _table(rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(row)} |" for row in [rows[0], ["---"] * len(rows[0]), *rows[1:]])
