"""The page of a proof: a matrix of steps and faults, coloured, with the findings and their replays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from eal_actors.lab.proof.cases import KILLED, Position
from eal_actors.lab.proof.invariants import INVARIANTS
from eal_actors.lab.proof.proof import Proof, ProvenCase
from eal_actors.recording.report_page import page_template

_TEMPLATE = "proof.html.j2"


@dataclass(frozen=True, slots=True)
class MatrixCell:
    """A step under a fault.

    Attributes:
        state: `done`, `safe` (it failed, and every invariant held) or `broken`.
        text: what happened, for the tooltip.
        link: the replay, or the finding on the page; empty for none.
    """

    state: str
    text: str
    link: str


@dataclass(frozen=True, slots=True)
class MatrixRow:
    """A step of a robot, with a cell for each kind of fault; None where it was not tried."""

    position: Position
    cells: tuple[MatrixCell | None, ...]


def render_proof(proof: Proof) -> str:
    """Return the page; raise UnsupportedError if Jinja is not installed."""
    links = _links(proof)
    return page_template(_TEMPLATE, "eal_actors.lab.proof").render(
        proof=proof,
        invariants=INVARIANTS,
        rows=_rows(proof, links),
        pairs=[(case, _cell(case, links)) for case in proof.cases if len(case.case) > 1],
        relative=lambda path: _relative(path, proof.out),
    )


def _links(proof: Proof) -> dict[int, str]:
    """Return the link of each case that violates something."""
    found: dict[int, str] = {}
    for number, finding in enumerate(proof.findings, 1):
        for case in finding.cases:
            found.setdefault(id(case), f"#finding-{number}")
        if finding.replay is not None:
            found[id(finding.cases[0])] = _relative(finding.replay, proof.out)
    return found


def _rows(proof: Proof, links: Mapping[int, str]) -> list[MatrixRow]:
    tried: dict[tuple[object, str], ProvenCase] = {}
    for case in proof.cases:
        if len(case.case) == 1:
            (fault,) = case.case
            key = fault.position.at_s if fault.kind == KILLED else fault.position
            tried[key, fault.kind] = case
    rows = []
    for position in sorted(proof.positions, key=lambda position: (position.robot, position.at_s)):
        found = (tried.get((position.at_s if kind == KILLED else position, kind)) for kind in proof.kinds)
        cells = tuple(None if case is None else _cell(case, links) for case in found)
        if any(cells):
            rows.append(MatrixRow(position, cells))
    return rows


def _cell(case: ProvenCase, links: Mapping[int, str]) -> MatrixCell:
    state = "broken" if case.violations else "done" if case.outcome == "done" else "safe"
    lines = [case.label, f"{case.outcome} after {case.duration_s:.2f} s", case.problem]
    lines += [f"{violation.invariant}: {violation.message}" for violation in case.violations]
    return MatrixCell(state, "\n".join(line for line in lines if line), links.get(id(case), ""))


def _relative(path: Path, folder: Path) -> str:
    return path.relative_to(folder).as_posix()
