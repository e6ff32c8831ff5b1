"""Commands with a time to begin, within a process."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from eal_actors.actors.call import Call
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.errors import (
    ArgumentError,
    CallCancelledError,
    DeadlineError,
    EALError,
    PreemptedError,
    StaleCommandError,
    StoppedError,
    UnsupportedError,
)
from eal_actors.kernel.lock_step import LockStepClock
from tests.robots import running_robot

Do = Callable[[RobotHandle], Future[Any]]


class Arm(Resource):
    """Notes when what begins."""

    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.DOUBLE, minimum=0, maximum=1)

    def __init__(self, clock: LockStepClock) -> None:
        self.clock = clock
        self.notes: list[tuple[float, str]] = []

    def note(self, what: str) -> None:
        self.notes.append((self.clock.now(), what))

    def get_value(self) -> float:
        self.clock.sleep(3.0)
        return 0.0

    def set_value(self, data: EALData) -> None:
        self.note(f"set {data.value:g}")

    @command("go<seconds>", ValueInfo(DataType.DOUBLE, "s", minimum=0))
    def go(self, seconds: float) -> Activity:
        self.note(f"go {seconds:g}")
        yield seconds

    @command("s", urgent=True)
    def stop(self) -> None:
        self.note("stop")

    def halt(self) -> None:
        self.note("halt")


class Quiet(Resource):
    """Takes no commands."""


class Rig:
    """A robot with an arm, in time that jumps."""

    def __init__(self, robot: RobotHandle, arm: Arm, clock: LockStepClock) -> None:
        self.robot = robot
        self.arm = arm
        self.clock = clock

    @property
    def handle(self) -> ResourceHandle:
        return self.robot["Arm"]

    def timed(self, command: str, at_s: float, timeout_s: float = 60.0) -> Call[int]:
        """Send a command that begins later, and let the arm read it."""
        call = self.handle.send_cmd(command, at_s=at_s, timeout_s=timeout_s)
        assert isinstance(call, Call)
        self.clock.sleep(0.1)
        return call


@pytest.fixture
def rig() -> Iterator[Rig]:
    clock = LockStepClock()
    clock.sleep(0)
    arm = Arm(clock)
    with running_robot({"Arm": lambda: arm, "Quiet": Quiet}, clock=clock) as robot:
        yield Rig(robot, arm, clock)


def test_a_command_begins_at_its_time(rig: Rig) -> None:
    call = rig.timed("go2", 1.0)
    assert not call.done()
    assert call.get() == 1
    assert rig.arm.notes == [(1.0, "go 2")]
    assert (call.began_s, rig.clock.now()) == (1.0, 3.0)


def test_a_value_is_set_at_its_time(rig: Rig) -> None:
    assert rig.handle.set_value(0.5, at_s=1.5).get() == 1
    assert rig.arm.notes == [(1.5, "set 0.5")]


def test_a_time_that_is_past_means_at_once(rig: Rig) -> None:
    rig.clock.sleep(5.0)
    call = rig.timed("go0", 2.0)
    assert call.get() == 1
    assert (call.began_s, rig.arm.notes) == (5.0, [(5.0, "go 0")])


def test_what_runs_goes_on_until_then(rig: Rig) -> None:
    before = rig.handle.send_cmd("go10", timeout_s=60.0)
    after = rig.timed("go1", 4.0)
    assert isinstance(before.exception(), PreemptedError)
    assert rig.clock.now() == 4.0
    assert after.get() == 1


@pytest.mark.parametrize(
    ("do", "notes"),
    [
        pytest.param(lambda robot: robot["Arm"].halt(), [(0.1, "halt")], id="halt"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("s"), [(0.1, "stop")], id="urgent command"),
        pytest.param(lambda robot: robot.stop("test"), [(0.1, "halt")], id="emergency stop"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("go1"), [(0.1, "go 1")], id="newer command"),
        pytest.param(lambda robot: robot["Arm"].set_value(1), [(0.1, "set 1")], id="newer value"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("go2", at_s=3.0), [(3.0, "go 2")], id="newer timed command"),
    ],
)
def test_it_is_called_off_by(rig: Rig, do: Do, notes: list[tuple[float, str]]) -> None:
    call = rig.timed("go5", 2.0)
    do(rig.robot).get()
    assert isinstance(call.exception(), PreemptedError)
    rig.clock.sleep(5.0)
    assert rig.arm.notes == notes
    assert call.began_s is None


@pytest.mark.parametrize(
    "do",
    [
        pytest.param(lambda robot: robot["Arm"].send_cmd("dance"), id="unknown command"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("go-1", at_s=1.0), id="timed command out of range"),
        pytest.param(lambda robot: robot["Arm"].set_value(7, at_s=1.0), id="timed value out of range"),
        pytest.param(lambda robot: robot["Arm"].send_cmd("go1", at_s=float("inf")), id="no time"),
    ],
)
def test_a_refused_command_calls_nothing_off_and_is_refused_at_once(rig: Rig, do: Do) -> None:
    call = rig.timed("go1", 2.0)
    assert isinstance(do(rig.robot).exception(), ArgumentError)
    assert rig.clock.now() == pytest.approx(0.1)
    assert call.get() == 1
    assert call.began_s == 2.0


def test_nothing_begins_after_an_emergency_stop_was_resumed(rig: Rig) -> None:
    call = rig.timed("go1", 2.0)
    rig.robot.stop("test").get()
    late = rig.timed("go1", 2.0)
    rig.robot.resume().get()
    rig.clock.sleep(3.0)
    assert isinstance(call.exception(), PreemptedError)
    assert isinstance(late.exception(), StoppedError)
    assert rig.arm.notes == [(0.1, "halt")]


def test_its_deadline_counts_on(rig: Rig) -> None:
    call = rig.timed("go5", 2.0, timeout_s=4.0)
    assert isinstance(call.exception(), DeadlineError)
    assert rig.clock.now() == 4.0
    rig.clock.sleep(0)
    assert rig.arm.notes == [(2.0, "go 5"), (4.0, "halt")]


def test_a_start_beyond_the_deadline_is_refused_at_once(rig: Rig) -> None:
    call = rig.timed("go1", 3.0, timeout_s=2.0)
    assert "is to begin 1 s after its deadline" in str(call.exception())
    assert isinstance(call.exception(), DeadlineError)
    assert rig.clock.now() == pytest.approx(0.1)


def test_one_that_is_cancelled_does_not_begin(rig: Rig) -> None:
    call = rig.timed("go1", 2.0)
    assert call.cancel()
    rig.clock.sleep(3.0)
    assert isinstance(call.exception(), CallCancelledError)
    assert rig.arm.notes == []


def test_one_that_wakes_up_too_late_does_not_begin(rig: Rig) -> None:
    call = rig.handle.start_call("send_cmd", ("go1", None), 60.0, begin_by_s=0.5, start_s=2.0)
    rig.clock.sleep(1.0)
    rig.handle.get_value().get()  # holds up the arm from 1 s until 4 s
    assert isinstance(call.exception(), StaleCommandError)
    assert rig.arm.notes == []


def test_one_that_wakes_up_a_little_late_begins(rig: Rig) -> None:
    call = rig.handle.start_call("send_cmd", ("go1", None), 60.0, begin_by_s=2.5, start_s=2.0)
    rig.clock.sleep(1.0)
    rig.handle.get_value().get()
    assert call.get() == 1
    assert call.began_s == 4.0


def test_a_closing_robot_calls_it_off(rig: Rig) -> None:
    call = rig.timed("go1", 2.0)
    rig.robot.close()
    error = call.exception()
    assert isinstance(error, EALError)
    assert "being stopped" in str(error)
    assert rig.arm.notes == [(rig.arm.notes[0][0], "halt")]


def test_who_takes_no_commands_says_so_at_once(rig: Rig) -> None:
    assert isinstance(rig.robot["Quiet"].send_cmd("go1", at_s=2.0).exception(), UnsupportedError)
    assert rig.clock.now() == 0.0
