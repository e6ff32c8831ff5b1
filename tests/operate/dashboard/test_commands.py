"""What a page asks for happens on the robots, and the page hears what came of it: without a browser."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError, ResourceBusyError, StaleCommandError, UnsupportedError
from eal_actors.operate.dashboard import Dashboard
from eal_actors.operate.dashboard.control import Control
from eal_actors.operate.dashboard.steering import SILENCE_S, Steering, Twist
from tests.manual_clock import ManualClock
from tests.operate.dashboard.rig import WAIT_S, counting_fleet, open_dashboard, page_of, resource_of

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
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with counting_fleet(tmp_path, "one", "two").connect() as opened:
        yield opened


@pytest.fixture
def dashboard(fleet: Fleet, tmp_path: Path) -> Iterator[Dashboard]:
    scenarios = tmp_path / "scenarios"
    scenarios.mkdir()
    (scenarios / "wait.yaml").write_text(SCENARIO)
    (scenarios / "broken.yaml").write_text("version: 1\nname: broken\n")
    (tmp_path / "secret.yaml").write_text(SCENARIO)
    with open_dashboard(fleet, scenarios=scenarios, runs_dir=tmp_path / "runs") as opened:
        yield opened


def test_a_panel_is_made_of_what_the_resources_say(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        base, pose = page.ask(do="describe", robot="one")["resources"]
    assert (base["name"], pose["name"]) == ("Base", "Pose")
    turn = next(command for command in base["commands"] if command["name"] == "turn<degrees>")
    assert (turn["argument"]["unit"], turn["argument"]["minimum"], turn["argument"]["maximum"]) == ("deg", 0, 360)


def test_calls_are_answered_and_what_is_out_of_range_is_refused(dashboard: Dashboard) -> None:
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


def test_what_runs_is_shown_and_stop_ends_it_and_latches(dashboard: Dashboard, fleet: Fleet) -> None:
    hold = {"do": "call", "resource": "Base", "method": "send_cmd", "text": "hold"}
    with page_of(dashboard) as page, page_of(dashboard) as other:
        for number, robot in enumerate(fleet):
            page.say(**hold, robot=robot, id=500 + number)
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


def test_scenarios_are_those_of_the_folder_alone(dashboard: Dashboard) -> None:
    with page_of(dashboard) as page:
        broken, wait = page.ask(do="scenarios")["scenarios"]
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
        assert page.ask(do="start", file="wait.yaml")["error"] == "a scenario is running already"
        page.ask(do="control", what="pause")
        page.hear_until(lambda: page.run["phase"] == "paused")
        page.ask(do="control", what="resume")
        page.hear_until(lambda: page.run["phase"] == "running")
        with page_of(dashboard) as late:  # who comes later gets the time line from its begin
            late.hear_until(lambda: any(event["event"] == "run_resumed" for event in late.events))
            assert late.events[0]["event"] == "run_started"
        page.ask(do="control", what="abort")
        page.hear_until(lambda: page.run["phase"] == "ended")
        assert page.run["outcome"] == "aborted"
        assert page.ask(do="control", what="pause")["error"] == "no scenario is running"
        assert any(line["text"] == "off we go" for line in page.logs)
        page.hear_until(lambda: "report" in page.run)  # the last thing that is written
    (folder,) = (tmp_path / "runs").iterdir()
    assert (folder / "summary.json").is_file()


def test_stop_aborts_the_run_too(dashboard: Dashboard, fleet: Fleet) -> None:
    with page_of(dashboard) as page:
        page.ask(do="start", file="wait.yaml")
        page.hear_until(lambda: sum(event["event"] == "step_started" for event in page.events) == 2)
        assert page.ask(do="stop")["ok"] is True
        page.hear_until(lambda: page.run["phase"] == "ended")
        assert page.run["outcome"] in ("aborted", "failed")


# Steering.


def test_a_robot_moves_while_its_driver_says_so(dashboard: Dashboard, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    with page_of(dashboard) as page, page_of(dashboard) as other:
        page.say(do="drive", robot="one", grip=1, speed_m_s=0.2, turn_rad_s=0.1)
        assert page.ask(do="call", robot="one", resource="Base", method="get_status")["ok"] in (True, False)
        assert base.twists >= 1
        page.hear_until(lambda: bool(page.troubles))  # nothing more was said
        assert "silence" in page.troubles[0]["error"]
        page.say(do="drive", robot="one", grip=1, speed_m_s=0.2, turn_rad_s=0.1)
        page.hear_until(lambda: len(page.troubles) == 2)
        assert (page.troubles[1]["code"], page.troubles[1]["grip"]) == ("stale_command", 1)
        assert base.twist == [0.0, 0.0]
        other.say(do="drive", robot="one", grip=1, speed_m_s=0.2, turn_rad_s=0.0)
        other.hear_until(lambda: bool(other.troubles))


def test_a_browser_that_goes_halts_what_it_steers(dashboard: Dashboard, fleet: Fleet) -> None:
    base = resource_of(fleet, "one", "Base")
    with page_of(dashboard) as page:
        page.say(do="drive", robot="one", grip=1, speed_m_s=0.2, turn_rad_s=0.1)
        page.ask(do="call", robot="one", resource="Base", method="get_status")
    fleet["one"]["Base"].get_status().exception(timeout=WAIT_S)
    assert (base.halts >= 1, base.twist) == (True, [0.0, 0.0])


class _Driver:
    """Steers with a clock that the test moves."""

    def __init__(self, fleet: Fleet) -> None:
        self.clock = ManualClock()
        self.steering = Steering(fleet, Control(self.clock), self.clock)
        self.troubles: list[EALError] = []
        self.is_troubled = threading.Event()

    def heed(self, robot: str, error: EALError) -> None:
        self.troubles.append(error)
        self.is_troubled.set()

    def drive(self, driver: str, robot: str, grip: int) -> None:
        self.steering.drive(driver, robot, grip, Twist(0.1, 0.0), self.heed)


@pytest.fixture
def driver(fleet: Fleet) -> Iterator[_Driver]:
    made = _Driver(fleet)
    made.steering.start()
    yield made
    made.steering.close()


def test_silence_halts_within_its_time_and_ends_the_grip(driver: _Driver, fleet: Fleet) -> None:
    driver.drive("a", "one", 1)
    driver.clock.advance(SILENCE_S * 0.9)
    driver.drive("a", "one", 1)
    driver.clock.advance(SILENCE_S * 0.9)
    assert not driver.is_troubled.is_set()
    driver.clock.advance(SILENCE_S * 0.2)
    assert driver.is_troubled.wait(WAIT_S)
    assert isinstance(driver.troubles[0], StaleCommandError)
    with pytest.raises(StaleCommandError, match="let the keys go"):
        driver.drive("a", "one", 1)
    driver.drive("a", "one", 2)


def test_a_late_word_does_not_undo_the_silence_before_it(driver: _Driver) -> None:
    driver.drive("a", "one", 5)
    driver.clock.advance(SILENCE_S)
    with pytest.raises(StaleCommandError):
        driver.drive("a", "one", 5)


def test_one_driver_at_a_time(driver: _Driver) -> None:
    driver.drive("a", "one", 1)
    with pytest.raises(ResourceBusyError, match="another browser"):
        driver.drive("b", "one", 1)
    driver.steering.let_go("b", "one")  # which is not his to let go
    with pytest.raises(ResourceBusyError):
        driver.drive("b", "one", 1)
    driver.steering.let_go("a", "one")
    driver.drive("b", "one", 1)


def test_after_a_stop_nothing_is_steered(driver: _Driver, fleet: Fleet) -> None:
    driver.drive("a", "one", 1)
    fleet.stop("test").get(timeout=WAIT_S)
    driver.drive("a", "one", 1)
    assert driver.is_troubled.wait(WAIT_S)
    assert driver.troubles[0].code == "stopped"


def test_what_takes_no_twist_cannot_be_steered(driver: _Driver, tmp_path: Path) -> None:
    from eal_actors.kernel.bundled import bundled_path

    with Fleet.load(bundled_path("fleets/local.yaml")).connect() as local:
        steering = Steering(local, Control())
        with pytest.raises(UnsupportedError, match="no Base that takes a twist"):
            steering.drive("a", next(iter(local)), 1, Twist(0, 0), driver.heed)
