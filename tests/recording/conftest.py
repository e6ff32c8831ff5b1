"""A recorded run that tests share and do not change."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.lock_step import MAX
from eal_actors.managers.config import EALConfigManager
from eal_actors.recording import Extent, RunRecorder, keep_provenance
from eal_actors.scenario import Run, load_scenario, make_plan
from tests.patience import LONG_S

SCENARIO = """\
version: 1
name: round
description: Half a square, a look, and a call that fails once.
roles: {drivers: {robots: [roomba-1, evbot3-1]}}
steps:
  - log: off we go
  - on: drivers
    do:
      - send_cmd: {resource: Base, cmd: f0.2}
      - send_cmd: {resource: Base, cmd: l90}
      - get_value: {resource: Camera}
        save: frame.png
"""


def record_run(directory: Path, extent: Extent, seed: int = 3) -> Path:
    """Run the scenario as fast as it goes, and record it; returns the run's folder."""
    directory.mkdir(parents=True)
    scenario = directory.parents[1] / "round.yaml"  # the same for runs side by side: its name is in the record
    scenario.write_text(SCENARIO)
    config = EALConfigManager.load(bundled_path("fleets/sim.yaml")).fleet
    config = dataclasses.replace(config, rate=MAX, seed=seed)
    with Fleet(config).connect() as fleet:
        plan = make_plan(load_scenario(scenario), fleet)
        recorder = RunRecorder(fleet, fleet, directory, extent)  # evbot2-1 just stands there
        run = Run(plan, fleet, directory, [recorder.hear])
        with recorder:
            report = run.start().get(timeout=LONG_S)
    assert report.outcome == "done", report
    keep_provenance(directory, config, plan.scenario)
    return directory


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of which everything was recorded. Not to be changed."""
    return record_run(tmp_path_factory.mktemp("recorded") / "one" / "run", "all")
