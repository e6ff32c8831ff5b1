"""`eal prove` finds planted bugs, and shrinks each to the robots and the faults that it needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.lab.proof import Proof, ProofRequest, prove
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario
from tests.proof.planted import PLANTED, PlantedBug

SHORT = ("a-fixed-pause-stands-for-the-way-being-clear",)
"""For every run of the tests; the others take minutes."""


def proof_of(bug: PlantedBug, folder: Path, *, faults: tuple[str, ...] | None = None) -> Proof:
    scenario, fleet = bug.write(folder)
    request = ProofRequest(
        load_scenario(scenario),
        EALConfigManager.load(fleet).fleet,
        folder / "proof",
        runs=60,
        jobs=2,
        kinds=bug.faults if faults is None else faults,
        within_s=bug.within_s,
    )
    return prove(request)


def check(bug: PlantedBug, folder: Path) -> None:
    proof = proof_of(bug, folder)
    found = [finding for finding in proof.findings if finding.invariant == bug.invariant and finding.least is not None]
    assert found, [(one.invariant, one.violation.message) for one in proof.findings]
    least = min((one.least for one in found if one.least is not None), key=lambda least: least.size)
    assert least.size == (bug.robots, 1 + bug.pair)
    print(f"{bug.name}: {least.size[0]} robots, {least.size[1]} faults, {len(proof.cases)} runs, {least.violation}")  # noqa: T201
    fleet_file = found[0].fleet_file
    assert fleet_file is not None
    assert EALConfigManager.load(fleet_file).fleet.rate == "max"


@pytest.mark.parametrize("bug", [bug for bug in PLANTED if bug.name in SHORT], ids=lambda bug: bug.name)
def test_a_planted_bug_is_found_and_shrunk(bug: PlantedBug, tmp_path: Path) -> None:
    check(bug, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("bug", PLANTED, ids=lambda bug: bug.name)
def test_every_planted_bug_is_found_and_shrunk(bug: PlantedBug, tmp_path: Path) -> None:
    check(bug, tmp_path)
