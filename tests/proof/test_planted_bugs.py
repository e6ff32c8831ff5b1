"""`eal prove` finds planted bugs, and shrinks each to the robots and the faults that it needs."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.lab.proof import Proof, ProofRequest, prove
from eal_actors.lab.proof.cases import find_positions, single_faults
from eal_actors.lab.proof.fleet_files import fleet_content, injectable_faults
from eal_actors.lab.proof.invariants import Trials, judge
from eal_actors.lab.proof.shrinking import task_of
from eal_actors.lab.proof.trial import TrialTask, TrialWorker
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario
from tests.proof.planted import PLANTED, PlantedBug


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


def test_a_fault_in_its_way_makes_one_robot_touch_another(tmp_path: Path) -> None:
    """The short form: one fault, in this process; the long form tries all, in worker processes."""
    (bug,) = (bug for bug in PLANTED if bug.name == "a-fixed-pause-stands-for-the-way-being-clear")
    scenario_file, fleet_file = bug.write(tmp_path)
    scenario, config = load_scenario(scenario_file), EALConfigManager.load(fleet_file).fleet
    content = fleet_content(config, None)
    worker = TrialWorker(scenario_file, scenario.parameters, None, fleet_file, limit_s=600)
    healthy = worker(TrialTask(content))
    assert healthy.report is not None
    positions = find_positions(healthy.report)
    cases = single_faults(positions, injectable_faults(config), healthy.start_s, bug.faults)
    ann = next(case for case in cases if case[0].robot == "ann")
    trials = [worker(task_of(content, ann)) for _ in range(2)]
    assert trials[0].touches == trials[1].touches  # to the bit
    assert trials[0].poses == trials[1].poses
    assert judge(Trials(scenario, (), healthy, healthy)) == ()
    (violation,) = judge(Trials(scenario, ann, healthy, trials[0]))
    assert violation.invariant == "contact"
    assert "ann touched bob at" in violation.message


@pytest.mark.slow
@pytest.mark.parametrize("bug", PLANTED, ids=lambda bug: bug.name)
def test_every_planted_bug_is_found_and_shrunk(bug: PlantedBug, tmp_path: Path) -> None:
    check(bug, tmp_path)
