"""The plan of a proof: which faults, when, and which pairs. Pure."""

from __future__ import annotations

from dataclasses import replace

from eal_actors.kernel.bundled import bundled_path
from eal_actors.lab.proof.cases import KILLED, FaultCase, Position, plan_cases, single_faults
from eal_actors.lab.proof.fleet_files import fleet_content, with_quick_settings
from eal_actors.lab.proof.invariants import Trials, judge
from eal_actors.lab.proof.trial import Trial
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.manifest import FaultSection
from eal_actors.scenario import Report, load_scenario
from eal_actors.scenario.report.summary import RobotReport

FAULTS = {
    "fails": FaultSection(settings={"failing": ["{resource}"]}),
    "back-again": FaultSection(settings={"dead": True}, lasts_s=5),
    "dead-camera": FaultSection(settings={"failing": ["Camera"]}, resources=("Camera",)),
}
DRIVE = Position("ann", "steps[0]", 1, "send_cmd Base f1", "Base", 2.0)
WAIT = Position("bob", "steps[1]", 1, "wait_for go", None, 3.0)


def singles() -> list[FaultCase]:
    return single_faults([DRIVE, WAIT], {"ann": ("sim", FAULTS), "bob": ("sim", FAULTS)}, start_s=0.5)


def test_each_fault_is_tried_where_it_can_happen() -> None:
    found = [(fault.robot, fault.kind, fault.at_s, fault.until_s) for (fault,) in singles()]
    assert found == [
        ("ann", KILLED, 2.5, None),
        ("ann", "fails", 2.5, None),
        ("ann", "back-again", 2.5, 7.5),
        ("bob", KILLED, 3.5, None),
        ("bob", "back-again", 3.5, 8.5),
        ("bob", "dead-camera", 3.5, None),
    ]
    assert singles()[1][0].settings == {"failing": ["Base"]}


def test_the_controller_is_killed_once_at_a_time() -> None:
    beside = Position("bob", "steps[0]", 1, "send_cmd Base f1", "Base", 2.0)
    kills = [case for case in single_faults([DRIVE, beside], {}, 0.0) if case[0].kind == KILLED]
    assert len(kills) == 1


def test_a_budget_keeps_a_fifth_for_pairs_of_different_steps() -> None:
    plan = plan_cases(singles(), 5, seed=1)
    assert [len(case) for case in plan] == [1, 1, 1, 1, 2]
    first, second = plan[-1]
    assert first.position != second.position
    assert plan == plan_cases(singles(), 5, seed=1)


def test_with_a_large_budget_no_single_fault_is_left_out() -> None:
    plan = plan_cases(singles(), 100, seed=1)
    assert plan[:6] == singles()
    assert len(set(map(str, plan[6:]))) == len(plan) - 6 == 4  # every pair of faults in different steps


def test_nothing_is_drawn_in_a_proof_that_nobody_sees() -> None:
    """Pictures of the tracker took half of the time."""
    config = EALConfigManager.load(bundled_path("fleets/relay.yaml")).fleet
    content = fleet_content(config, None)
    quick = with_quick_settings(content, config.plugin_dirs)
    tracker = quick["robots"]["cameras-1"]["plugins"].pop("tracker")
    assert tracker == {**content["robots"]["cameras-1"]["plugins"].pop("tracker"), "drawn": False}
    assert quick == content


def test_nobody_can_halt_a_robot_that_nobody_reaches() -> None:
    """A search ends when another robot finds the beacon, and a robot that hangs drives to the end of its lane."""
    (fault,) = next(case for case in singles() if case[0].kind == "fails")
    moving = Trial(None, moved_m={"ann": 0.3, "bob": 0.0})
    scenario = load_scenario(bundled_path("scenarios/search.yaml"))
    for is_unreachable, violated in ((False, ["halted"]), (True, [])):
        case = (replace(fault, is_unreachable=is_unreachable),)
        assert [one.invariant for one in judge(Trials(scenario, case, Trial(None), moving))] == violated


def test_the_place_of_a_robot_is_not_judged_where_another_was_dropped() -> None:
    """A wedge of eight robots has other places than one of nine."""
    (fault,) = next(case for case in singles() if case[0].kind == "fails")
    scenario = load_scenario(bundled_path("scenarios/ballet.yaml"))
    healthy = Trial(None, poses={"ann": (0.0, 0.0, 0.0)})
    for other, violated in ((RobotReport(outcome="done"), ["outcome"]), (RobotReport(outcome="dropped"), [])):
        robots = {"ann": RobotReport(outcome="done"), "bob": other}
        report = Report.model_construct(
            outcome="done", error=None, robots=robots, roles={}, steps=[], duration_s=9.0, continued_s=()
        )
        trial = Trial(report, poses={"ann": (0.42, 0.0, 0.0)})
        assert [one.invariant for one in judge(Trials(scenario, (fault,), healthy, trial))] == violated
