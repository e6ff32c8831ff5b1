"""A robot that is lost on its way to a place and rejoins: it drives nowhere before its next meeting."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path

from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import RobotLost, Run, RunEvent, StepStarted, load_scenario, make_plan
from tests.net.rig import WAIT_S, ready
from tests.unit.plugins.served_robot import served_robot

VISITS = """
version: 1
name: visits
roles: {all: {}}
on_lost: {wait_s: 1000, rejoin: true}
lost_after_s: 0.5
steps:
- on: all
  do:
  - visit: [[2, 0], [0, 0]]
    do:
    - wait_s: 0.1
    - {barrier: met, timeout_s: 1000}
    - wait_s: 0.2
"""


def test_a_robot_that_was_lost_visits_no_place_before_its_next_meeting(tmp_path: Path) -> None:
    """It drove to the second place, and left out the meeting at the first one."""
    (tmp_path / "visits.yaml").write_text(VISITS)
    is_driving, is_lost = threading.Event(), threading.Event()

    def listen(event: RunEvent) -> None:
        if isinstance(event, StepStarted) and event.step_kind == "visit":
            is_driving.set()
        elif isinstance(event, RobotLost):
            is_lost.set()

    with ExitStack() as service:
        file = service.enter_context(served_robot(tmp_path, "r1"))
        with ready(Fleet.load(file)) as fleet:
            running = Run(make_plan(load_scenario(tmp_path / "visits.yaml"), fleet), fleet, None, [listen]).start()
            assert is_driving.wait(WAIT_S)
            service.close()
            assert is_lost.wait(WAIT_S)
            with RobotService(EALConfigManager.load(file).fleet, "r1"):
                report = running.get(timeout=2 * WAIT_S)
    assert report.outcome == "done"
    assert [(step.kind, step.outcome) for step in report.steps] == [
        ("visit", "skipped"), ("wait_s", "skipped"), ("barrier", "done"), ("wait_s", "done"),
        ("visit", "done"), ("wait_s", "done"), ("barrier", "done"), ("wait_s", "done"),
    ]  # fmt: skip
