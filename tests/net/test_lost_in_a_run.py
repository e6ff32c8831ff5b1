"""A robot that is lost while a scenario runs: its step fails, its role decides, and it may come back."""

from __future__ import annotations

import json
import re
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.scenario import Report, RobotLost, Run, RunEvent, load_scenario, make_plan
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, ready, serving

LOST_AFTER_S = 0.5
LONGER_S = 1000.0
"""Longer than any test may take: nothing waits for it."""
MOVE = f"""
version: 1
name: move
roles: {{all: {{min: 2, max: 3, spares: SPARES}}}}
on_lost: POLICY
PATIENCE
timeout_s: {LONGER_S}
steps:
- on: all
  do:
  - if: robot == 'r1'
    then:
    - send_cmd: {{resource: Arm, cmd: move{LONGER_S:g}}}
      lost_after_s: {LOST_AFTER_S}
  - send_cmd: {{resource: Arm, cmd: step1}}
  - barrier: middle
    timeout_s: {LONGER_S}
  - send_cmd: {{resource: Arm, cmd: step2}}
"""
"""r1 moves until it is lost; the others wait for it at the barrier."""
MOTION = f"move{LONGER_S:g}"


@dataclass
class Loss:
    """A run of the scenario while r1's server is killed.

    Attributes:
        rig: the robots and their notes.
        report: the report of the run.
        events: the kinds of events about r1.
    """

    rig: Rig
    report: Report
    events: list[str]


def lose(
    folder: Path,
    policy: str,
    *,
    robots: int = 3,
    spares: int = 0,
    patience_s: float | None = None,
    restart: bool = False,
    then: Callable[[Rig, Run], object] = lambda *_: None,
    end: signal.Signals = signal.SIGKILL,
) -> Loss:
    """Run the scenario, and kill r1's server while that moves.

    Args:
        folder: an empty folder.
        policy: the scenario's `on_lost`.
        robots: their number.
        spares: how many of them are spares.
        patience_s: the scenario's `lost_after_s`; that of the network if None.
        restart: start the server again when the loss is noticed.
        then: called after that, while the scenario runs.
        end: the signal that ends the server.
    """
    rig = Rig(folder, [f"r{number + 1}" for number in range(robots)], {"lost_after_s": LOST_AFTER_S})
    values = {
        "POLICY": policy,
        "SPARES": str(spares),
        "PATIENCE": f"lost_after_s: {patience_s:g}" if patience_s else "",
    }
    text = re.sub("|".join(values), lambda found: values[found[0]], MOVE)
    (folder / "move.yaml").write_text(text, encoding="utf-8")
    noticed = threading.Event()

    def listen(event: RunEvent) -> None:
        if isinstance(event, RobotLost):
            noticed.set()

    with serving(rig.file, *rig.config.robots) as servers, ready(Fleet(rig.config)) as fleet:
        plan = make_plan(load_scenario(folder / "move.yaml"), fleet)
        run = Run(plan, fleet, folder / "run", [listen])
        running = run.start()
        assert rig.begun(MOTION)
        servers["r1"].signal(end)
        assert noticed.wait(WAIT_S)
        if restart:
            servers.start("r1")
        then(rig, run)
        report = running.get(timeout=2 * WAIT_S)
    lines = (folder / "run" / "events.jsonl").read_text(encoding="utf-8").splitlines()
    events = map(json.loads, lines)
    return Loss(rig, report, [event["event"] for event in events if event.get("robot") == "r1"])


def outcomes(report: Report) -> list[str]:
    """Return the outcomes of the run and of its robots."""
    return [report.outcome, *(robot.outcome for robot in report.robots.values())]


def test_the_others_go_on_without_a_robot_whose_server_was_killed(tmp_path: Path) -> None:
    """The step's own patience counts; they waited until the deadline of its command, and the run was `failed`."""
    loss = lose(tmp_path, "drop", patience_s=LONGER_S)
    assert outcomes(loss.report) == ["done", "dropped", "done", "done"]
    assert loss.report.robots["r1"].error is not None
    assert loss.events[-2:] == ["robot_lost", "robot_dropped"]
    (times,) = loss.report.robots["r1"].losses
    assert times.back_s is None
    assert loss.rig.steps().count("2") == 2


def test_the_others_go_on_without_a_robot_whose_server_was_stopped(tmp_path: Path) -> None:
    """Its command failed before it was lost, so `on_failure` applied; and before that, as in an emergency stop."""
    loss = lose(tmp_path, "drop", end=signal.SIGTERM)
    assert outcomes(loss.report) == ["done", "dropped", "done", "done"]
    assert loss.report.robots["r1"].error is not None
    assert "its server is being stopped" in loss.report.robots["r1"].error.message
    assert "emergency" not in loss.report.robots["r1"].error.message


@pytest.mark.parametrize("policy", ["fail", "drop"])
def test_the_run_fails_if_it_must_or_has_too_few_robots(policy: str, tmp_path: Path) -> None:
    loss = lose(tmp_path, policy, robots=2)
    assert outcomes(loss.report) == ["failed", "failed" if policy == "fail" else "dropped", "aborted"]
    assert "2" not in loss.rig.steps()


@pytest.mark.slow
def test_a_spare_takes_the_place_of_a_lost_robot_at_the_step_that_failed(tmp_path: Path) -> None:
    def wait_for_it(rig: Rig, run: Run) -> None:
        assert eventually(lambda: bool(rig.notes("begin", robot="r4")))
        run.abort("the spare moves")

    loss = lose(tmp_path, "substitute", robots=4, spares=1, then=wait_for_it)
    assert loss.report.robots["r1"].outcome == "replaced"
    assert loss.events[-2:] == ["robot_lost", "robot_replaced"]


@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGTERM])
def test_a_robot_that_comes_back_rejoins_at_the_next_barrier(tmp_path: Path, end: signal.Signals) -> None:
    loss = lose(tmp_path, f"{{wait_s: {LONGER_S}, rejoin: true}}", restart=True, end=end)
    assert outcomes(loss.report) == ["done", "done", "done", "done"]
    assert loss.events.index("robot_lost") < loss.events.index("robot_returned")
    (times,) = loss.report.robots["r1"].losses
    assert times.back_s is not None
    skipped = [step.label for step in loss.report.steps if (step.robot, step.outcome) == ("r1", "skipped")]
    assert skipped == [f"send_cmd Arm {MOTION}", "send_cmd Arm step1"]
    assert (loss.rig.steps().count("1"), loss.rig.steps().count("2")) == (2, 3)


@pytest.mark.slow
def test_a_robot_that_comes_back_repeats_the_step_that_failed(tmp_path: Path) -> None:
    def wait_for_it(rig: Rig, run: Run) -> None:
        assert eventually(lambda: len(rig.notes("begin", robot="r1")) == 2)
        run.abort("it moves again")

    loss = lose(tmp_path, f"{{wait_s: {LONGER_S}, then: drop}}", restart=True, then=wait_for_it)
    assert outcomes(loss.report)[0] == "aborted"
