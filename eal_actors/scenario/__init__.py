"""Scenarios: what a whole fleet is to do, checked before anything moves, run in parallel, and reported honestly.

with Fleet.load("fleets/sim.yaml") as fleet:
    report = run_scenario(Path("scenarios/dance.yaml"), fleet)
"""

from eal_actors.scenario.engine import Listener, Run, run_scenario
from eal_actors.scenario.events import (
    Checkpoint,
    Event,
    LogLine,
    RobotDropped,
    RobotReplaced,
    RunContinued,
    RunEnded,
    RunPaused,
    RunResumed,
    RunStarted,
    Signalled,
    StartedTogether,
    StepEnded,
    StepRetried,
    StepStarted,
)
from eal_actors.scenario.loading import check_scenario, load_scenario, parse_scenario, scenario_schema
from eal_actors.scenario.plan import Plan, make_plan
from eal_actors.scenario.python_steps import StepContext
from eal_actors.scenario.report import (
    ErrorReport,
    Report,
    RobotReport,
    StartReport,
    StepRecord,
    summary_schema,
)
from eal_actors.scenario.resuming import Resumption, read_run
from eal_actors.scenario.scenario import Scenario
from eal_actors.scenario.timeline import Entry, Timeline

__all__ = [
    "Checkpoint",
    "Entry",
    "ErrorReport",
    "Event",
    "Listener",
    "LogLine",
    "Plan",
    "Report",
    "Resumption",
    "RobotDropped",
    "RobotReplaced",
    "RobotReport",
    "Run",
    "RunContinued",
    "RunEnded",
    "RunPaused",
    "RunResumed",
    "RunStarted",
    "Scenario",
    "Signalled",
    "StartReport",
    "StartedTogether",
    "StepContext",
    "StepEnded",
    "StepRecord",
    "StepRetried",
    "StepStarted",
    "Timeline",
    "check_scenario",
    "load_scenario",
    "make_plan",
    "parse_scenario",
    "read_run",
    "run_scenario",
    "scenario_schema",
    "summary_schema",
]
