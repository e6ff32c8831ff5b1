"""Scenarios: what a whole fleet is to do, checked before anything moves, run in parallel, and reported honestly.

with Fleet.load("fleets/sim.yaml") as fleet:
    report = run_scenario(Path("scenarios/dance.yaml"), fleet)
"""

from eal_actors.scenario.engine import Run, run_scenario
from eal_actors.scenario.events import (
    Event,
    LogLine,
    RobotDropped,
    RunEnded,
    RunStarted,
    StepEnded,
    StepRetried,
    StepStarted,
)
from eal_actors.scenario.plan import Plan, make_plan
from eal_actors.scenario.report import ErrorReport, Report, RobotReport, StepRecord, summary_schema
from eal_actors.scenario.scenario import Scenario, check_scenario, load_scenario, scenario_schema

__all__ = [
    "ErrorReport",
    "Event",
    "LogLine",
    "Plan",
    "Report",
    "RobotDropped",
    "RobotReport",
    "Run",
    "RunEnded",
    "RunStarted",
    "Scenario",
    "StepEnded",
    "StepRecord",
    "StepRetried",
    "StepStarted",
    "check_scenario",
    "load_scenario",
    "make_plan",
    "run_scenario",
    "scenario_schema",
    "summary_schema",
]
