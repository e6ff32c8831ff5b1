"""Faults of robots and wires through the whole stack: scenario, actors, driver, wire, emulator, wheels.

Nothing moves after a failure, of which the robot's own wheels bear witness; the record names robot, resource and step;
and when the device is back, all of it works again, without a restart.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from eal_actors.actors.future import Future
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import Listener, Report, Run, RunEvent, Signalled, StepRetried, load_scenario, make_plan
from plugins.roomba.bodies import ConstantBattery
from tests.emulated import PATIENT, WAIT_S, Emulated, a_roomba, an_evbot2, an_evbot3, plugged_in, plugin_of
from tests.scenarios.rig import HEAD as SCENARIO_HEAD
from tests.scenarios.running import ON

MAKES: dict[str, Callable[[], Emulated[Any]]] = {"evbot2": an_evbot2, "evbot3": an_evbot3, "roomba": a_roomba}
SLOW = 0.4
"""Rate of time where a robot must succeed: a delay of a busy machine must not look like a fault."""
WATCHDOG_S = 3.0
"""Longer than any robot's own watchdog."""

HEAD = f"{SCENARIO_HEAD}timeout_s: 60\n{ON}"
SLOWLY = """
- set_config: {resource: Base, key: speed_m_s, value: 0.1}
- set_config: {resource: Base, key: turn_rate_deg_s, value: 20}
"""
"""Slow motions, so that a delay of a busy machine costs the driver little odometry."""
FAR = f"{SLOWLY}- send_cmd: {{resource: Base, cmd: f5}}"
AGAIN = """
- send_cmd: {resource: Base, cmd: f0.05}
  on_failure: {retry: 40, back_off_s: 0.2, factor: 1, then: abort}
- send_cmd: {resource: Base, cmd: l20}
  on_failure: {retry: 40, back_off_s: 0.2, factor: 1, then: abort}
"""


@contextmanager
def fleet_of(rate: float = 1.0, **plugins: Mapping[str, Any]) -> Iterator[Fleet]:
    robots = {name: {"plugins": instances} for name, instances in plugins.items()}
    with Fleet(EALConfigManager.of({"version": 1, "clock": {"rate": rate}, "robots": robots}).fleet) as fleet:
        yield fleet


def start(fleet: Fleet, folder: Path, steps: str, *listeners: Listener) -> Future[Report]:
    """Start a scenario whose robots all do these steps; its record is in the folder."""
    folder.mkdir(exist_ok=True)
    file = folder / "trial.yaml"
    file.write_text(HEAD + textwrap.indent(textwrap.dedent(steps).lstrip("\n"), "  "), encoding="utf-8")
    return Run(make_plan(load_scenario(file), fleet), fleet, folder, listeners).start()


def failure(folder: Path) -> tuple[str, str, str, str]:
    """Return robot, resource, label and message of the failed step; check that all parts of the record agree."""
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    (failed,) = [step for step in summary["steps"] if step["outcome"] == "failed"]
    lines = map(json.loads, (folder / "events.jsonl").read_text(encoding="utf-8").splitlines())
    assert [line["record"] for line in lines if line["event"] == "step_ended"][-1] == failed
    assert summary["outcome"] == summary["robots"][failed["robot"]]["outcome"] == "failed"
    assert failed["error"]["message"] in summary["error"]["message"]
    return failed["robot"], failed["resource"], failed["label"], failed["error"]["message"]


def works_again(fleet: Fleet, folder: Path, robot: Emulated[Any], name: str = "hero") -> None:
    """Check that a robot obeys and that nothing was restarted."""
    before_m = robot.travelled_m
    assert start(fleet, folder / "again", AGAIN).get(timeout=WAIT_S).outcome == "done"
    assert robot.travelled_m - before_m > 0.04
    assert robot.stands()
    assert fleet[name].restarts == {}


@pytest.mark.parametrize(
    "make", [pytest.param("evbot2", marks=pytest.mark.slow), pytest.param("evbot3", marks=pytest.mark.slow), "roomba"]
)
def test_a_port_that_closes_in_the_middle_of_a_frame(make: str, tmp_path: Path) -> None:
    with plugged_in(MAKES[make]()) as robot, fleet_of(hero=plugin_of(make, robot.address)) as fleet:
        robot.strike_after(0.03, robot.cut)
        running = start(fleet, tmp_path, FAR)
        assert robot.struck.wait(WAIT_S)
        robot.unplug()
        assert running.get(timeout=WAIT_S).outcome == "failed"
        robot.let_pass(WATCHDOG_S)
        assert robot.stands()
        assert robot.travelled_m < 2
        name, resource, label, message = failure(tmp_path)
        assert (name, resource, label) == ("hero", "Base", "send_cmd Base f5")
        assert message.startswith("hero/Base: ")
        assert robot.address in message
        robot.plug_in()
        works_again(fleet, tmp_path, robot)


@pytest.mark.parametrize(
    "make", ["evbot2", pytest.param("evbot3", marks=pytest.mark.slow), pytest.param("roomba", marks=pytest.mark.slow)]
)
def test_a_device_that_is_unplugged_and_plugged_in_while_a_scenario_tries_again(make: str, tmp_path: Path) -> None:
    with plugged_in(MAKES[make]()) as robot, fleet_of(hero=plugin_of(make, robot.address)) as fleet:
        stood: list[bool] = []

        def hear(event: RunEvent) -> None:
            if isinstance(event, StepRetried) and not stood:
                robot.let_pass(WATCHDOG_S)
                stood.append(robot.stands())
                robot.plug_in()

        robot.strike_after(0.03, robot.cut)
        steps = """
            - send_cmd: {resource: Base, cmd: f0.1}
              on_failure: {retry: 40, back_off_s: 0.2, factor: 1, then: abort}
            - send_cmd: {resource: Base, cmd: l20}
              on_failure: {retry: 40, back_off_s: 0.2, factor: 1, then: abort}
            - get_value: {resource: Odometry}
        """
        running = start(fleet, tmp_path, steps, hear)
        assert robot.struck.wait(WAIT_S)
        robot.unplug()
        report = running.get(timeout=WAIT_S)
        assert (report.outcome, stood) == ("done", [True])
        first, *others = report.steps
        assert first.attempts > 1
        assert [step.outcome for step in (first, *others)] == ["done"] * 3
        retried = [line for line in (tmp_path / "events.jsonl").read_text().splitlines() if '"step_retried"' in line]
        assert '"hero"' in retried[0]
        assert robot.address in retried[0]
        assert robot.stands()
        assert fleet["hero"].restarts == {}


@pytest.mark.parametrize(("make", "off_m"), [("evbot3", 0.005), pytest.param("roomba", 0.03, marks=pytest.mark.slow)])
def test_a_radio_that_loses_three_packets_of_ten(make: str, off_m: float, tmp_path: Path) -> None:
    rate = {"evbot3": 1.0, "roomba": SLOW}[make]
    robot: Emulated[Any] = an_evbot3(0.3, 5) if make == "evbot3" else a_roomba(0.3, 5, 5, rate)
    with plugged_in(robot), fleet_of(rate, hero=plugin_of(make, robot.address)) as fleet:
        moves = ["f0.05", "l30", "f0.05"]
        steps = SLOWLY + "".join(f"- send_cmd: {{resource: Base, cmd: {move}}}\n" for move in moves)
        report = start(fleet, tmp_path, steps).get(timeout=WAIT_S)
        assert report.outcome == "done", report.error
        assert robot.stands()
        assert robot.body.pose[:2] == pytest.approx((0.0933, 0.025), abs=off_m)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_radio_that_never_sends_again_what_it_lost_fails_by_name_if_at_all(seed: int, tmp_path: Path) -> None:
    with plugged_in(a_roomba(loss=0.3, seed=seed)) as robot, fleet_of(hero=plugin_of("roomba", robot.address)) as fleet:
        running = start(
            fleet, tmp_path, "- send_cmd: {resource: Base, cmd: f0.4}\n- send_cmd: {resource: Base, cmd: l45}"
        )
        if running.get(timeout=WAIT_S).outcome != "done":
            assert failure(tmp_path)[:2] == ("hero", "Base")
        robot.let_pass(WATCHDOG_S)
        assert robot.stands()


@pytest.mark.parametrize(
    "make", [pytest.param("evbot2", marks=pytest.mark.slow), "evbot3", pytest.param("roomba", marks=pytest.mark.slow)]
)
def test_a_robot_that_freezes_fails_alone_and_stands_when_it_thaws(make: str, tmp_path: Path) -> None:
    with (
        plugged_in(MAKES[make]()) as robot,
        plugged_in(an_evbot2()) as mate,
        fleet_of(hero=plugin_of(make, robot.address), mate=plugin_of("evbot2", mate.address)) as fleet,
    ):
        robot.strike_after(0.03, robot.freeze)
        steps = """
            - set_config: {resource: Base, key: speed_m_s, value: 0.1}
            - if: robot == 'hero'
              then:
                - send_cmd: {resource: Base, cmd: f5}
                  on_failure: drop
              else:
                - send_cmd: {resource: Base, cmd: f0.2}
        """
        report = start(fleet, tmp_path, steps).get(timeout=WAIT_S)
        assert robot.struck.is_set()
        assert {name: robot.outcome for name, robot in report.robots.items()} == {"hero": "dropped", "mate": "done"}
        (lost,) = [step for step in report.steps if step.outcome == "dropped"]
        assert (lost.robot, lost.resource, lost.command) == ("hero", "Base", "f5")
        assert lost.error is not None
        assert lost.error.code in ("unavailable", "not_ready")
        assert mate.body.pose[0] == pytest.approx(0.2, abs=0.005)
        robot.thaw()
        robot.let_pass(WATCHDOG_S)
        assert robot.stands()
        works_again(fleet, tmp_path, robot)


def _freeze(process: subprocess.Popen[str], event: RunEvent) -> None:
    if isinstance(event, Signalled):
        process.send_signal(signal.SIGSTOP)


def test_a_program_that_is_stopped_by_a_signal_and_goes_on(tmp_path: Path) -> None:
    program = [sys.executable, "-m", "plugins.evbot2.emulator", "--pty"]
    with subprocess.Popen(program, cwd=bundled_path("."), stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            with fleet_of(hero={"evbot2": {"port": process.stdout.readline().strip(), **PATIENT}}) as fleet:
                steps = """
                    - parallel:
                        - - send_cmd: {resource: Base, cmd: f5}
                        - - wait_until: value('Odometry')[0] > 0.03
                            timeout_s: 30
                          - signal: moving
                """
                moving = start(fleet, tmp_path, steps, partial(_freeze, process))
                assert moving.get(timeout=WAIT_S).outcome == "failed"
                assert failure(tmp_path)[:3] == ("hero", "Base", "send_cmd Base f5")
                process.send_signal(signal.SIGCONT)
                assert start(fleet, tmp_path / "again", AGAIN).get(timeout=WAIT_S).outcome == "done"
                believed = fleet["hero"]["Odometry"].get_value().get().value
                process.terminate()
                pose = [float(number) for number in process.stdout.readline().split()[1::2]]
        finally:
            process.kill()
    assert pose[:2] == pytest.approx(list(believed[:2]), abs=0.005)


@pytest.mark.slow
def test_a_battery_that_runs_low_ends_the_drive(tmp_path: Path) -> None:
    with plugged_in(a_roomba(rate=SLOW)) as robot, fleet_of(SLOW, hero=plugin_of("roomba", robot.address)) as fleet:
        robot.strike_after(0.05, lambda: setattr(robot.body, "charge", ConstantBattery(charge_ah=0.27)))
        steps = """
            - set_config: {resource: Base, key: speed_m_s, value: 0.1}
            - parallel:
                drive:
                  - send_cmd: {resource: Base, cmd: f10}
                watch:
                  - wait_until: value('Battery') < 0.2
                    timeout_s: 60
                  - expect: value('Battery') >= 0.2
                    says: "${robot} runs out of charge"
        """
        assert start(fleet, tmp_path, steps).get(timeout=WAIT_S).outcome == "failed"
        assert robot.stands()
        assert 0.05 < robot.travelled_m < 5
        summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
        ends = {step["label"]: (step["robot"], step["outcome"]) for step in summary["steps"]}
        assert ends["send_cmd Base f10"] == ("hero", "aborted")
        assert ("hero", "failed") in ends.values()
        assert "hero runs out of charge" in summary["robots"]["hero"]["error"]["message"]
        robot.body.charge = ConstantBattery()
        works_again(fleet, tmp_path, robot)


def over_a_cliff(robot: Emulated[Any]) -> None:
    robot.body.over_cliffs = (False, True, False, False)


def test_a_cliff_in_a_curve(tmp_path: Path) -> None:
    with plugged_in(a_roomba(rate=SLOW)) as robot, fleet_of(SLOW, hero=plugin_of("roomba", robot.address)) as fleet:
        robot.strike_after(0.05, lambda: over_a_cliff(robot))
        steps = """
            - set_config: {resource: Base, key: twist_timeout_s, value: 30}
            - set_value: {resource: Base, value: [0.2, 0.8]}
        """
        assert start(fleet, tmp_path, steps).get(timeout=WAIT_S).outcome == "failed"
        assert robot.stands()
        assert robot.body.pose[2] > 0.05  # it was turning
        name, resource, _, message = failure(tmp_path)
        assert (name, resource) == ("hero", "Base")
        assert message == "hero/Base: halted: cliff (front left)"
        robot.body.over_cliffs = (False,) * 4
        works_again(fleet, tmp_path, robot)


@pytest.mark.slow
def test_a_cliff_beside_a_turn_in_place_forbids_the_way_forward(tmp_path: Path) -> None:
    with plugged_in(a_roomba(rate=SLOW)) as robot, fleet_of(SLOW, hero=plugin_of("roomba", robot.address)) as fleet:
        robot.strike_after(0.02, lambda: over_a_cliff(robot))
        steps = f"{SLOWLY}- send_cmd: {{resource: Base, cmd: l30}}\n- send_cmd: {{resource: Base, cmd: f0.5}}"
        assert start(fleet, tmp_path, steps).get(timeout=WAIT_S).outcome == "failed"
        assert robot.stands()
        assert robot.body.pose[:2] == pytest.approx((0.0, 0.0), abs=0.01)  # it never went forward
        assert failure(tmp_path) == (
            "hero",
            "Base",
            "send_cmd Base f0.5",
            "hero/Base: halted: cliff (front left)",
        )


@pytest.mark.slow
def test_a_wheel_that_drops_in_a_turn(tmp_path: Path) -> None:
    with plugged_in(a_roomba(rate=SLOW)) as robot, fleet_of(SLOW, hero=plugin_of("roomba", robot.address)) as fleet:
        robot.strike_after(0.02, lambda: setattr(robot.body, "dropped", (True, False, False)))
        assert (
            start(fleet, tmp_path, f"{SLOWLY}- send_cmd: {{resource: Base, cmd: l720}}").get(timeout=WAIT_S).outcome
            == "failed"
        )
        assert robot.stands()
        assert failure(tmp_path)[3] == "hero/Base: halted: wheel drop (left wheel)"
        robot.body.dropped = (False,) * 3
        works_again(fleet, tmp_path, robot)
