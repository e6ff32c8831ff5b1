"""The folder of a finding: its least fleet file, the record of its run, and the page of that run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import get_logger
from eal_actors.lab.proof.fleet_files import Content, load_content, write_fleet
from eal_actors.lab.proof.trial import TrialWorker, ends_before, stop_run
from eal_actors.recording import RunFolder, RunRecorder, keep_provenance, render_report
from eal_actors.scenario import Run, make_plan

LEAST_FLEET: Final = "least-fleet.yaml"
REPLAY: Final = "run/report.html"
_RECORDED_S: Final = 600.0
"""A longer run is recorded up to this time of the fleet's clock."""


def keep_finding(content: Content, comments: Sequence[str], worker: TrialWorker, folder: Path) -> None:
    """Write the least fleet file of a finding, with comments at its head, and record one run with it in a new folder.

    Raises OSError if a file cannot be written.
    """
    folder.mkdir(parents=True)
    write_fleet(content, comments, folder / LEAST_FLEET)
    try:
        _record(content, worker, folder / "run")
    except EALError as error:  # the fleet file is the finding; its record is a convenience
        get_logger().warning("a finding has no record", folder=str(folder), reason=str(error))


def _record(content: Content, worker: TrialWorker, directory: Path) -> None:
    config, scenario = load_content(content, worker.source), worker.loaded
    directory.mkdir()
    keep_provenance(directory, config, scenario)
    with Fleet(config).connect() as fleet:
        plan = make_plan(scenario, fleet, binding=worker.binding)
        with RunRecorder(fleet, plan.robots, directory) as recorder:
            run = Run(plan, fleet, directory, [recorder.hear])
            future = run.start()
            if not ends_before(future, fleet.clock, _RECORDED_S):
                stop_run(run, future, fleet.clock)
    (directory / "report.html").write_text(render_report(RunFolder.open(directory), config.world), encoding="utf-8")
