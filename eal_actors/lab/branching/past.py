"""The input of a recorded run, read back from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.lock_step import MAX
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.recording import RunFolder
from eal_actors.recording.provenance import FLEET, kept_scenario
from eal_actors.scenario import Report, Scenario, load_scenario
from eal_actors.scenario.report.journal import EVENTS


@dataclass(frozen=True, slots=True)
class RecordedInput:
    """The input of a run."""

    folder: RunFolder
    report: Report
    scenario: Scenario
    config: FleetConfig
    binding: Mapping[str, list[str]]

    @property
    def robots(self) -> set[str]:
        """The robots that took part, spares included."""
        return {name for names in self.binding.values() for name in names}


def read_input(run: Path) -> RecordedInput:
    """Read the input of a run that can be repeated.

    Raises:
        ScenarioError: it is no folder of a run, its events have lost their beginning, the run has not ended, was
            resumed, or was not in lock step.
        ConfigError: a file in the folder was changed and is invalid.
    """
    folder = RunFolder.open(run)
    report = folder.summary
    if report is None or report.continued_s:
        state = "has not ended" if report is None else "was resumed"
        raise ScenarioError(f"the run in {run} {state}; only a run from its start to its end can be repeated")
    if report.rate != MAX:
        raise ScenarioError(f"the run in {run} was made at rate {report.rate:g}; only a run with --rate max repeats")
    started = next(iter(folder.events), {})
    if started.get("event") != "run_started":
        raise ScenarioError(f"{run / EVENTS} does not begin with the event run_started")
    config = EALConfigManager.load(run / FLEET, environment={}).fleet
    return RecordedInput(
        folder,
        report,
        load_scenario(kept_scenario(run), report.parameters),
        replace(config, source=Path(report.fleet_file)),
        {role: [*names, *started["spares"].get(role, ())] for role, names in started["roles"].items()},
    )
