"""Scenarios: steps for a whole fleet, checked before anything moves, run in parallel, and reported.

with Fleet.load("fleets/sim.yaml") as fleet:
    report = run_scenario(Path("scenarios/dance.yaml"), fleet)
"""

from eal_actors.scenario.engine.plan import Plan, make_plan
from eal_actors.scenario.engine.run import Run, run_scenario
from eal_actors.scenario.language.loading import check_scenario, load_scenario, parse_scenario, scenario_schema
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.report.events import (
    Checkpoint,
    LogLine,
    RobotDropped,
    RobotLost,
    RobotReplaced,
    RobotReturned,
    RunContinued,
    RunEnded,
    RunEvent,
    RunPaused,
    RunResumed,
    RunStarted,
    Signalled,
    StartedTogether,
    StepEnded,
    StepRetried,
    StepStarted,
)
from eal_actors.scenario.report.journal import Listener
from eal_actors.scenario.report.resuming import Resumption, read_run
from eal_actors.scenario.report.summary import (
    ErrorReport,
    LossReport,
    Report,
    RobotReport,
    StartReport,
    StepRecord,
    summary_schema,
)
from eal_actors.scenario.report.timeline import Timeline, TimelineEntry
from eal_actors.scenario.steps.python import StepContext

Entry = TimelineEntry
"""The former name."""
Event = RunEvent
"""The former name."""

__all__ = [
    "Checkpoint",
    "Entry",
    "ErrorReport",
    "Event",
    "Listener",
    "LogLine",
    "LossReport",
    "Plan",
    "Report",
    "Resumption",
    "RobotDropped",
    "RobotLost",
    "RobotReplaced",
    "RobotReport",
    "RobotReturned",
    "Run",
    "RunContinued",
    "RunEnded",
    "RunEvent",
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
    "TimelineEntry",
    "check_scenario",
    "load_scenario",
    "make_plan",
    "parse_scenario",
    "read_run",
    "run_scenario",
    "scenario_schema",
    "summary_schema",
]
