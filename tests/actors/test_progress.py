"""Progress reports of activities and their receivers."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RunningCommand, process_name
from eal_actors.device.info import ResourceType
from eal_actors.device.resource import Activity, Progress, Resource, command, request
from eal_actors.kernel.errors import ArgumentError, PreemptedError
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S, advance_until_done, running_robot


class Lift(Resource):
    """Goes up in four steps of a second."""

    types = ResourceType.ACTUATOR

    @command("up")
    def up(self) -> Activity:
        for step in range(4):
            self.progress(step / 4, f"floor {step}")
            yield 1.0
        return 4

    @command("mute")
    def mute(self) -> Activity:
        yield 5.0

    @command("beyond")
    def beyond(self) -> Activity:
        self.progress(1.5)
        yield 1.0
        self.progress(-1.0)
        self.progress(text="nobody knows")
        yield 1.0

    @command("nan")
    def nan(self) -> Activity:
        self.progress(float("nan"))
        yield 1.0

    @request("look")
    def look(self) -> Activity:
        self.progress(0.5)
        yield 1.0
        return 7

    @request("idle")
    def idle(self) -> int:
        self.progress(0.9)  # no activity: of nothing
        return 1

    def halt(self) -> None: ...


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def robot(clock: ManualClock) -> Iterator[RobotHandle]:
    with running_robot({"Lift": Lift}, clock=clock) as robot:
        yield robot


def test_progress_is_told_step_by_step(clock: ManualClock, robot: RobotHandle) -> None:
    heard: list[Progress] = []
    call = robot["Lift"].send_cmd("up")
    call.add_progress_callback(heard.append)
    advance_until_done(clock, call)
    assert call.get() == 4
    assert [(progress.fraction, progress.text) for progress in heard] == [(n / 4, f"floor {n}") for n in range(4)]
    steps_s = [heard[n + 1].time_s - heard[n].time_s for n in range(3)]
    assert steps_s == pytest.approx([1.0] * 3, abs=0.2)  # the clock goes on while the actor works
    assert call.progress() is heard[-1]


def test_who_asks_later_is_told_what_is_known(clock: ManualClock, robot: RobotHandle) -> None:
    call = robot["Lift"].send_cmd("up")
    robot["Lift"].get_value().exception(timeout=WAIT_S)  # answered behind it; a status would overtake it
    heard: list[Progress] = []
    call.add_progress_callback(heard.append)
    assert [progress.text for progress in heard] == ["floor 0"]


def test_a_callback_that_raises_disturbs_nobody(clock: ManualClock, robot: RobotHandle) -> None:
    heard: list[Progress] = []

    def fail(_: Progress) -> None:
        raise ZeroDivisionError

    call = robot["Lift"].send_cmd("up")
    call.add_progress_callback(fail)
    call.add_progress_callback(heard.append)
    advance_until_done(clock, call)
    assert call.get() == 4
    assert heard[-1].text == "floor 3"


def test_fractions_stay_between_0_and_1(clock: ManualClock, robot: RobotHandle) -> None:
    heard: list[Progress] = []
    call = robot["Lift"].send_cmd("beyond")
    call.add_progress_callback(heard.append)
    advance_until_done(clock, call)
    assert [(progress.fraction, progress.text) for progress in heard] == [(1.0, ""), (None, "nobody knows")]
    error = robot["Lift"].send_cmd("nan").exception(timeout=WAIT_S)
    assert isinstance(error, ArgumentError)


def test_what_a_plain_call_tells_is_about_nothing(clock: ManualClock, robot: RobotHandle) -> None:
    idle = robot["Lift"].send_req("idle")
    assert idle.get().value == 1
    mute = robot["Lift"].send_cmd("mute")
    advance_until_done(clock, mute)
    assert idle.progress() is None
    assert mute.progress() is None


def test_what_runs_is_listed(clock: ManualClock, robot: RobotHandle) -> None:
    assert list(robot.running) == []
    call = robot["Lift"].send_cmd("up")
    look = robot["Lift"].send_req("look")
    robot["Lift"].get_value().exception(timeout=WAIT_S)
    listed: list[RunningCommand] = list(robot.running)
    assert len(listed) == 1  # a request is no command
    running = listed[0]
    assert (running.resource, running.command, running.by) == ("Lift", "up", process_name())
    assert running.since_s == clock.now()
    assert running.progress is not None
    assert running.progress.text == "floor 0"
    assert robot.ping().get().running == robot.running
    assert running.to_dict()["progress"] == {"fraction": 0.0, "text": "floor 0", "time_s": clock.now()}
    advance_until_done(clock, look)
    robot["Lift"].halt().get()
    assert list(robot.running) == []
    assert isinstance(call.exception(), PreemptedError)
