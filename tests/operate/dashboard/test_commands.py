"""Requests of a page reach the robots, and are answered. Without a browser."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, ResourceBusyError, StaleCommandError, UnsupportedError
from eal_actors.operate.dashboard import Dashboard
from eal_actors.operate.dashboard.control import ControlRegistry, DashboardContext
from eal_actors.operate.dashboard.dispatcher import HEARD_S
from eal_actors.operate.dashboard.run_manager import RunManager
from eal_actors.operate.dashboard.state_store import CurrentSteps, StateStore
from eal_actors.operate.dashboard.teleop import SILENCE_S, Teleop, Twist
from tests.manual_clock import ManualClock
from tests.operate.dashboard.rig import WAIT_S, open_dashboard, page_of, resource_of, wait_for

SCENARIO = """\
version: 1
name: wait
description: Robots hold until somebody aborts.
parameters:
  rounds: {type: int, default: 1, minimum: 1, maximum: 3, description: how often}
roles: {all: {}}
timeout_s: 3600
steps:
  - log: off we go
  - on: all
    do:
      - send_cmd: {resource: Base, cmd: hold}
finally:
  - on: all
    do:
      - send_cmd: {resource: Base, cmd: turn9}
"""

CHOICE = """\
version: 1
name: choose
roles: {all: {}}
steps:
  - on: all
    do:
      - repeat: 3
        do:
          - if: index == 0
            then:
              - send_cmd: {resource: Base, cmd: turn9}
"""


@pytest.fixture
def dashboard(fleet: Fleet, tmp_path: Path) -> Iterator[Dashboard]:
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "wait.yaml").write_text(SCENARIO)
    (scenarios / "choose.yaml").write_text(CHOICE)
    (scenarios / "broken.yaml").write_text("version: 1\nname: broken\n")
    (tmp_path / "secret.yaml").write_text(SCENARIO)
    with open_dashboard(fleet, scenarios=scenarios, runs_dir=tmp_path / "runs") as opened:
        yield opened


def test_describe_returns_the_descriptions_of_the_resources(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        base, pose = page.ask(do="describe", robot="one")["resources"]
    assert (base["name"], pose["name"]) == ("Base", "Pose")
    turn = next(command for command in base["commands"] if command["name"] == "turn<degrees>")
    assert (turn["argument"]["unit"], turn["argument"]["minimum"], turn["argument"]["maximum"]) == ("deg", 0, 360)


def test_calls_are_answered_and_checked(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        call = {"do": "call", "robot": "one", "resource": "Base", "method": "send_cmd"}
        assert page.ask(**call, text="turn45")["value"] == "1"
        refused = page.ask(**call, text="turn400")
        assert (refused["code"], "0..360 deg" in refused["error"]) == ("argument", True)
        failed = page.ask(**call, text="fail")
        assert failed["code"] == "resource_fault"
        assert "<b>wheel</b> fell off" in failed["error"]
        page.hear_until(lambda: "fell off" in str(page.robots.get("one", {}).get("last_error")))
        assert page.ask(**{**call, "robot": "three"}, text="turn45")["code"] == "robot_not_found"
        assert page.ask(**{**call, "resource": "Bse"}, text="turn45")["code"] == "resource_not_found"


def test_stop_ends_running_commands_and_latches(dashboard: Dashboard, fleet: Fleet) -> None:
    hold = {"do": "call", "resource": "Base", "method": "send_cmd", "text": "hold"}
    with page_of(dashboard) as page, page_of(dashboard) as other:
        for number, robot in enumerate(fleet):
            page.say(**hold, robot=robot, id=500 + number, heard_s=page.heard_s())
        page.hear_until(lambda: all(page.robots.get(robot, {}).get("running") for robot in fleet))
        running = page.robots["one"]["running"][0]
        assert (running["resource"], running["command"], running["by"]) == ("Base", "hold", None)
        assert page.robots["one"]["control"] == {"Base": page.hello["you"]}
        answer = other.ask(do="stop")
        assert (answer["ok"], answer["confirmed"]) == (True, ["one", "two"])
        assert all(resource_of(fleet, robot, "Base").halts for robot in fleet)
        page.hear_until(lambda: {500, 501} <= set(page.answers))
        assert page.answers[500]["code"] == "preempted"
        page.hear_until(lambda: all(page.robots[robot]["stopped"] for robot in fleet))
        assert page.ask(**hold, robot="one")["code"] == "stopped"
        assert page.ask(do="resume")["ok"] is True
        assert page.ask(do="call", robot="one", resource="Base", method="send_cmd", text="turn5")["ok"] is True


def test_a_command_that_was_held_up_is_not_executed(dashboard: Dashboard, fleet: Fleet) -> None:
    """As after a sleep of the dashboard's computer: the page's commands waited in the connection meanwhile."""
    base = {"do": "call", "robot": "one", "resource": "Base", "method": "send_cmd"}
    with page_of(dashboard) as page:
        assert page.ask(**base, text="turn45")["ok"] is True
        old_s = page.heard_s() - HEARD_S - 0.1
        late: tuple[dict[str, Any], ...] = (
            {**base, "text": "turn45"},
            {"do": "command", "robots": ["one"], "resource": "Base", "text": "turn45"},
            {"do": "start", "file": "wait.yaml"},
            {"do": "resume"},
            {"do": "control", "what": "resume"},
        )
        for message in late:
            for heard_s in (old_s, None):
                assert page.ask(**message, heard_s=heard_s)["code"] == "stale_command", message
        page.say(do="drive", robot="one", press=1, speed_m_s=0.2, turn_rad_s=0.0, heard_s=old_s)
        page.hear_until(lambda: bool(page.drive_errors))
        assert (page.drive_errors[0]["code"], page.drive_errors[0]["press"]) == ("stale_command", 1)
        assert resource_of(fleet, "one", "Base").twists == 0
        halt = {"do": "command", "robots": ["one"], "resource": "", "text": "halt"}
        for message in ({"do": "stop"}, {**base, "method": "halt"}, halt):
            assert page.ask(**message, heard_s=old_s)["ok"] is True


def test_only_scenarios_of_the_folder_are_listed_and_started(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        broken, _, wait = page.ask(do="scenarios")["scenarios"]
        assert (broken["file"], bool(broken["problems"])) == ("broken.yaml", True)
        assert wait["parameters"]["rounds"]["maximum"] == 3
        for file in ("../secret.yaml", "/etc/passwd", "secret.yaml", "missing.yaml"):
            answer = page.ask(do="start", file=file)
            assert (answer["code"], "there is no scenario" in answer["error"]) == ("scenario", True)
        wrong = page.ask(do="start", file="wait.yaml", parameters={"rounds": 9})
        assert "rounds" in wrong["problems"][0]


def test_a_run_is_started_paused_resumed_and_aborted(dashboard: Dashboard, tmp_path: Path) -> None:
    with page_of(dashboard) as page:
        assert page.ask(do="start", file="wait.yaml", parameters={"rounds": 2})["ok"] is True
        page.hear_until(lambda: sum(event["event"] == "step_started" for event in page.events) == 2)
        assert page.ask(do="start", file="wait.yaml")["error"] == "a scenario is already running"
        page.ask(do="control", what="pause")
        page.hear_until(lambda: page.run["phase"] == "paused")
        page.ask(do="control", what="resume")
        page.hear_until(lambda: page.run["phase"] == "running")
        with page_of(dashboard) as late:  # a later page gets the events from the start
            late.hear_until(lambda: any(event["event"] == "run_resumed" for event in late.events))
            assert late.events[0]["event"] == "run_started"
        page.ask(do="control", what="abort")
        page.hear_until(lambda: page.run["phase"] == "ended")
        assert page.run["outcome"] == "aborted"
        assert page.ask(do="control", what="pause")["error"] == "no scenario is running"
        assert any(line["text"] == "off we go" for line in page.logs)
        page.hear_until(lambda: "report" in page.run)  # the last thing that is written
    (folder,) = (each for each in (tmp_path / "runs").iterdir() if each.is_dir())
    assert (folder / "summary.json").is_file()


def test_stop_aborts_the_run_too(dashboard: Dashboard, fleet: Fleet) -> None:
    with page_of(dashboard) as page:
        page.ask(do="start", file="wait.yaml")
        page.hear_until(lambda: sum(event["event"] == "step_started" for event in page.events) == 2)
        assert page.ask(do="stop")["ok"] is True
        page.hear_until(lambda: page.run["phase"] == "ended")
        assert page.run["outcome"] == "aborted"
        refused = page.ask(do="call", robot="one", resource="Base", method="send_cmd", text="turn9")
        assert refused["code"] == "stopped"
        assert page.ask(do="resume")["ok"] is True
        page.hear_until(lambda: all(page.robots[name]["stopped"] is None for name in fleet))
        assert {name: page.robots[name]["last_error"] for name in fleet} == {"one": None, "two": None}


def test_a_stop_from_elsewhere_leaves_no_last_error(dashboard: Dashboard, fleet: Fleet) -> None:
    with page_of(dashboard) as page:
        page.ask(do="start", file="wait.yaml")
        page.hear_until(lambda: sum(event["event"] == "step_started" for event in page.events) == 2)
        fleet.stop("a button on the wall").get(timeout=WAIT_S)
        page.hear_until(lambda: page.run["phase"] == "ended")
        fleet.resume().get(timeout=WAIT_S)
        page.hear_until(lambda: all(page.robots[name]["stopped"] is None for name in fleet))
        assert {name: page.robots[name]["last_error"] for name in fleet} == {"one": None, "two": None}


def test_a_run_that_is_done_counts_the_calls_it_made(dashboard: Dashboard, tmp_path: Path) -> None:
    with page_of(dashboard) as page:
        page.ask(do="start", file="choose.yaml")
        page.hear_until(lambda: page.run["phase"] == "ended" and "report" in page.run)
    (summary,) = (tmp_path / "runs").glob("*/summary.json")
    made = sum(step["resource"] is not None for step in json.loads(summary.read_text())["steps"])
    assert (page.run["done"], page.run["calls"], page.run["outcome"]) == (made, made, "done")


# Driving by hand.


def test_a_robot_moves_while_drive_messages_come(dashboard: Dashboard, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    with page_of(dashboard) as page, page_of(dashboard) as other:
        page.drive(robot="one", press=1, speed_m_s=0.2, turn_rad_s=0.1)
        assert page.ask(do="call", robot="one", resource="Base", method="get_status")["ok"] in (True, False)
        assert base.twists >= 1
        page.hear_until(lambda: bool(page.drive_errors))  # no more drive messages
        assert "no drive message" in page.drive_errors[0]["error"]
        page.drive(robot="one", press=1, speed_m_s=0.2, turn_rad_s=0.1)
        page.hear_until(lambda: len(page.drive_errors) == 2)
        assert (page.drive_errors[1]["code"], page.drive_errors[1]["press"]) == ("stale_command", 1)
        wait_for(base, lambda: base.twist == [0.0, 0.0])
        other.drive(robot="one", press=1, speed_m_s=0.2, turn_rad_s=0.0)
        other.hear_until(lambda: bool(other.drive_errors))


def test_a_browser_that_disconnects_halts_its_robot(dashboard: Dashboard, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    with page_of(dashboard) as page:
        page.drive(robot="one", press=1, speed_m_s=0.2, turn_rad_s=0.1)
        page.ask(do="call", robot="one", resource="Base", method="get_status")
    wait_for(base, lambda: base.halts >= 1 and base.twist == [0.0, 0.0])


def test_a_robot_that_a_scenario_commands_is_not_driven_by_hand(dashboard: Dashboard, fleet: Fleet) -> None:
    """A drive message ended the scenario's command, and the scenario failed."""
    with page_of(dashboard) as page:
        page.ask(do="start", file="wait.yaml")
        page.hear_until(lambda: sum(event["event"] == "step_started" for event in page.events) == 2)
        page.drive(robot="one", press=1, speed_m_s=0.2, turn_rad_s=0.0)
        page.hear_until(lambda: bool(page.drive_errors))
        assert page.drive_errors[0]["code"] == "resource_busy"
        assert page.drive_errors[0]["error"] == "scenario wait commands it: abort the scenario to drive by hand"
        page.ask(do="control", what="abort")
        page.hear_until(lambda: page.run["phase"] == "ended")
        assert page.run["outcome"] == "aborted"
    assert resource_of(fleet, "one", "Base").twists == 0


class _Driver:
    """Drives by hand, with a manual clock."""

    def __init__(self, fleet: Fleet) -> None:
        self.clock = ManualClock()
        self.control = ControlRegistry(self.clock)
        self.teleop = Teleop(fleet, self.control, self.clock)
        self.errors: list[EALError] = []
        self.has_failed = threading.Event()

    def on_error(self, robot: str, error: EALError) -> None:
        self.errors.append(error)
        self.has_failed.set()

    def drive(self, driver: str, robot: str, press: int, speed_m_s: float = 0.1) -> None:
        self.teleop.drive(driver, robot, press, Twist(speed_m_s, 0.0), self.on_error)


@pytest.fixture
def driver(fleet: Fleet) -> Iterator[_Driver]:
    made = _Driver(fleet)
    made.teleop.start()
    yield made
    made.teleop.close()


def test_silence_halts_in_time_and_ends_the_press(driver: _Driver, fleet: Fleet) -> None:
    driver.drive("a", "one", 1)
    driver.clock.advance(SILENCE_S * 0.9)
    driver.drive("a", "one", 1)
    driver.clock.advance(SILENCE_S * 0.9)
    assert not driver.has_failed.is_set()
    driver.clock.advance(SILENCE_S * 0.2)
    assert driver.has_failed.wait(WAIT_S)
    assert isinstance(driver.errors[0], StaleCommandError)
    with pytest.raises(StaleCommandError, match="release the keys"):
        driver.drive("a", "one", 1)
    driver.drive("a", "one", 2)


def test_a_refused_twist_halts_a_robot_that_follows_the_one_before(driver: _Driver, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    driver.drive("a", "one", 1)
    wait_for(base, lambda: base.twist == [0.1, 0.0])
    driver.drive("a", "one", 1, speed_m_s=9.0)
    assert driver.has_failed.wait(WAIT_S)
    assert driver.errors[0].code == "argument"
    wait_for(base, lambda: base.twist == [0.0, 0.0])  # the clock stands: no dead-man's switch did it


def test_a_late_message_does_not_undo_the_silence_before_it(driver: _Driver) -> None:
    driver.drive("a", "one", 5)
    driver.clock.advance(SILENCE_S)
    with pytest.raises(StaleCommandError):
        driver.drive("a", "one", 5)


def test_one_driver_at_a_time(driver: _Driver) -> None:
    driver.drive("a", "one", 1)
    with pytest.raises(ResourceBusyError, match="another browser"):
        driver.drive("b", "one", 1)
    driver.teleop.release("b", "one")  # another browser's press
    with pytest.raises(ResourceBusyError):
        driver.drive("b", "one", 1)
    driver.teleop.release("a", "one")
    driver.drive("b", "one", 1)


def test_no_scenario_starts_with_a_robot_that_is_driven_by_hand(driver: _Driver, fleet: Fleet, tmp_path: Path) -> None:
    (tmp_path / "wait.yaml").write_text(SCENARIO)
    runs = RunManager(
        DashboardContext(fleet, StateStore(), CurrentSteps(), driver.control), tmp_path, tmp_path / "runs"
    )
    driver.drive("a", "two", 1)
    with pytest.raises(ResourceBusyError, match="two: it is driven by hand: release the keys to start scenario wait"):
        runs.start("wait.yaml", {})
    driver.drive("b", "one", 1)  # the scenario keeps nothing
    driver.teleop.release("b", "one")
    assert list((tmp_path / "runs").glob("*")) == []
    driver.teleop.release("a", "two")
    runs.start("wait.yaml", {})
    runs.close()


def test_after_a_stop_driving_is_refused(driver: _Driver, fleet: Fleet) -> None:
    driver.drive("a", "one", 1)
    fleet.stop("test").get(timeout=WAIT_S)
    driver.drive("a", "one", 1)
    assert driver.has_failed.wait(WAIT_S)
    assert driver.errors[0].code == "stopped"


def test_a_robot_that_takes_no_twist_cannot_be_driven(driver: _Driver, tmp_path: Path) -> None:
    from eal_actors.kernel.bundled import bundled_path

    with Fleet.load(bundled_path("fleets/local.yaml")).connect() as local:
        teleop = Teleop(local, ControlRegistry())
        with pytest.raises(UnsupportedError, match="no Base that takes a twist"):
            teleop.drive("a", next(iter(local)), 1, Twist(0, 0), driver.on_error)
