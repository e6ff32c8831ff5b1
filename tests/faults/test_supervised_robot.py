"""Crashes, hangs and failed starts: each is named, halts the robot, and leaves no call waiting."""

from __future__ import annotations

import itertools
import sys
import threading
from functools import partial
from typing import Any

import pytest

from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.actors.robot_actor import RobotSpec, start_robot
from eal_actors.actors.robot_view import RobotState
from eal_actors.actors.supervision import Restart
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.clock import REAL_TIME, ScaledClock
from eal_actors.kernel.errors import (
    DeadlineError,
    PreemptedError,
    ResourceFaultError,
    ResourceNotFoundError,
    RobotFailedError,
    UnavailableError,
)
from tests.manual_clock import ManualClock
from tests.net.links import eventually
from tests.robots import WAIT_S, InlinePlugins, running_robot


class Motor(Resource):
    """A motor that fails on demand; all its instances share one list of notes."""

    def __init__(self, notes: list[str]) -> None:
        self.notes = notes
        self.notes.append("new")
        self.spinning = threading.Event()

    def get_value(self) -> int:
        return self.notes.count("new")

    def halt(self) -> None:
        self.notes.append("halt")

    @command("exit")
    def exit(self) -> None:
        sys.exit(3)

    @command("drive")
    def drive(self) -> Activity:
        try:
            while True:
                yield 1.0
        finally:
            self.notes.append("motors off")

    @command("spin")
    def spin(self) -> None:
        pause = threading.Event()
        self.spinning.set()
        try:
            while True:
                pause.wait(0.001)
        finally:
            self.notes.append("unwound")


def call_until_up(handle: ResourceHandle, clock: ManualClock | None = None) -> Any:
    """Ask until the restarted resource answers."""
    end_s = REAL_TIME.now() + WAIT_S
    while True:
        if clock is not None:
            clock.advance(0.1)
        call = handle.get_value(timeout_s=1e6)
        try:
            return call.get().value
        except UnavailableError:
            assert REAL_TIME.now() < end_s, "it was never restarted"


def test_system_exit_is_a_crash_of_that_resource_alone() -> None:
    notes: list[str] = []
    clock = ManualClock()
    with running_robot({"Motor": partial(Motor, notes), "Other": partial(Motor, [])}, clock=clock) as robot:
        with pytest.raises(ResourceFaultError, match="robot/Motor: send_cmd 'exit' raised SystemExit: 3"):
            robot["Motor"].send_cmd("exit").get()
        assert robot["Other"].get_value(timeout_s=1e6).get().value == 1
        assert call_until_up(robot["Motor"], clock) == 2
        assert notes == ["new", "halt", "new"]
        assert robot.restarts == {"Motor": 1}
        assert robot.state is RobotState.READY


def test_callers_that_wait_when_it_crashes_hear_of_it() -> None:
    entered, gate = threading.Event(), threading.Event()

    class Fragile(Resource):
        """Crashes while calls are queued."""

        @command("break")
        def break_(self) -> None:
            entered.set()
            gate.wait(WAIT_S)
            sys.exit(1)

    with running_robot({"Fragile": Fragile}) as robot:
        handle = robot["Fragile"]
        handle.send_cmd("break")
        assert entered.wait(WAIT_S)
        waiting = [handle.send_cmd("break") for _ in range(3)]
        gate.set()
        for call in waiting:
            with pytest.raises(UnavailableError, match="robot/Fragile: it crashed: SystemExit"):
                call.get()


def test_more_than_three_crashes_in_the_window_stop_the_whole_robot_safely() -> None:
    notes: list[str] = []
    other: list[str] = []
    clock = ManualClock()
    resources = {"Motor": partial(Motor, notes), "Other": partial(Motor, other)}
    with running_robot(resources, clock=clock, restart_window_s=1e6) as robot:  # the clock moves in large steps
        drive = robot["Other"].send_cmd("drive", timeout_s=1e9)
        robot["Other"].get_value().get()
        for life in itertools.count(1):
            with pytest.raises(ResourceFaultError):
                robot["Motor"].send_cmd("exit").get()
            if life == 4:
                break
            assert call_until_up(robot["Motor"], clock) == life + 1
        with pytest.raises(PreemptedError, match="being stopped"):
            drive.get(timeout=WAIT_S)
        assert robot.state is RobotState.FAILED
        with pytest.raises(RobotFailedError, match=r"robot/Other: stopped safely after more than 3.*SystemExit"):
            robot["Other"].get_value().get()
        assert other == ["new", "motors off", "halt"]


def test_a_temporary_resource_is_not_restarted() -> None:
    clock = ManualClock()
    with running_robot({"Motor": partial(Motor, [])}, clock=clock, restart=Restart.TEMPORARY) as robot:
        with pytest.raises(ResourceFaultError):
            robot["Motor"].send_cmd("exit").get()
        end_s = REAL_TIME.now() + WAIT_S
        while "not restarted (temporary)" not in str(robot["Motor"].get_value().exception()):
            assert REAL_TIME.now() < end_s
        clock.advance(100.0)
        assert isinstance(robot["Motor"].get_value().exception(), UnavailableError)
        assert (robot.state, robot.restarts) == (RobotState.READY, {})


@pytest.mark.parametrize("restart", [Restart.PERMANENT, Restart.TEMPORARY])
def test_an_emergency_stop_is_confirmed_though_a_resource_has_crashed(restart: Restart) -> None:
    notes: list[str] = []
    resources = {"Motor": partial(Motor, notes), "Crashed": partial(Motor, [])}
    with running_robot(resources, restart=restart) as robot:
        driving = robot["Motor"].send_cmd("drive")
        with pytest.raises(ResourceFaultError):
            robot["Crashed"].send_cmd("exit").get()
        robot.stop("smoke")  # fails if the crash is not known yet
        with pytest.raises(PreemptedError, match="smoke"):
            driving.get()
        assert eventually(lambda: robot.is_stop_confirmed)
        robot.stop("again").get()
        assert robot.stopped_because == "smoke"
        assert notes.count("halt") >= 1


def test_an_error_in_a_background_activity_restarts_the_resource() -> None:
    lives = itertools.count(1)

    class Poller(Resource):
        """Its first instance loses its device."""

        def __init__(self) -> None:
            self.life = next(lives)

        def background(self) -> Activity:
            yield 0.0
            if self.life == 1:
                raise OSError("unplugged")

        def get_value(self) -> int:
            return self.life

    clock = ScaledClock(50)
    with running_robot({"Poller": Poller}, clock=clock) as robot:
        end_s = REAL_TIME.now() + WAIT_S
        while call_until_up(robot["Poller"]) != 2:
            assert REAL_TIME.now() < end_s


def test_a_call_that_hangs_fails_at_its_deadline_and_the_resource_is_replaced() -> None:
    notes: list[str] = []
    clock = ScaledClock(20)
    with running_robot({"Motor": partial(Motor, notes), "Other": partial(Motor, [])}, clock=clock) as robot:
        hung = robot["Motor"].send_cmd("spin", timeout_s=8.0)
        behind = robot["Motor"].get_value(timeout_s=1e6)
        with pytest.raises(DeadlineError, match="robot/Motor: send_cmd 'spin'"):
            hung.get()
        with pytest.raises(UnavailableError, match="stuck"):
            behind.get()
        assert robot["Other"].get_value(timeout_s=1e6).get().value == 1
        assert call_until_up(robot["Motor"]) == 2
    assert "unwound" in notes
    assert notes.index("unwound") < notes.index("halt", notes.index("unwound"))


def test_a_resource_that_does_not_open_in_time_says_so() -> None:
    gate = threading.Event()

    class Slow(Resource):
        """Opens when it may."""

        def open(self) -> None:
            gate.wait(WAIT_S)

    with running_robot({"Slow": Slow}, clock=ScaledClock(20), wait=False, timeout_s=8.0) as robot:
        try:
            why = "did not open within its 8 s; it has been abandoned"
            assert eventually(lambda: why in str(robot["Slow"].get_value(timeout_s=1e6).exception()))
        finally:
            gate.set()


def test_a_resource_that_never_opens_fails_its_robot() -> None:
    """It was tried for ever, and each try left a thread behind."""
    gate, tries = threading.Event(), list[threading.Thread]()

    class Hanging(Resource):
        """Hangs when it is opened."""

        def open(self) -> None:
            tries.append(threading.current_thread())
            gate.wait(WAIT_S)

    with running_robot({"Hanging": Hanging}, clock=ScaledClock(50), wait=False, timeout_s=8.0) as robot:
        try:
            assert eventually(lambda: robot.state is RobotState.FAILED)
            assert "Hanging did not open 4 times in a row; last, it did not open within" in str(robot.problems[-1])
            assert len(tries) == 4
        finally:
            gate.set()


def test_a_call_of_a_stuck_resource_fails_with_its_deadline_though_nobody_waits_for_it() -> None:
    with running_robot({"Motor": partial(Motor, [])}, clock=ScaledClock(20)) as robot:
        hung = robot["Motor"].send_cmd("spin", timeout_s=8.0)
        assert call_until_up(robot["Motor"]) == 2  # by now the supervisor has replaced it
        assert isinstance(hung.exception(), DeadlineError)


def test_a_hang_is_noticed_through_callbacks_too() -> None:
    clock = ScaledClock(20)
    heard = threading.Event()
    with running_robot({"Motor": partial(Motor, [])}, clock=clock) as robot:
        robot["Motor"].send_cmd("spin", timeout_s=8.0).add_done_callback(lambda _: heard.set())
        assert heard.wait(WAIT_S)
        assert call_until_up(robot["Motor"]) == 2


def test_a_thread_blocked_for_ever_is_left_behind_halted_and_named(capsys: pytest.CaptureFixture[str]) -> None:
    release, halted = threading.Event(), threading.Event()

    class Deaf(Resource):
        """Blocks inside the operating system, where no exception reaches it."""

        @command("block")
        def block(self) -> None:
            release.wait()

        def halt(self) -> None:
            halted.set()

    clock = ScaledClock(20)
    with running_robot({"Deaf": Deaf}, clock=clock, close_timeout_s=0.2, max_restarts=0) as robot:
        with pytest.raises(DeadlineError):
            robot["Deaf"].send_cmd("block", timeout_s=8.0).get()
        assert halted.wait(WAIT_S)
    assert "robot/Deaf" in capsys.readouterr().err
    release.set()  # so that this test leaves no thread behind


def test_a_resource_that_was_only_late_is_not_replaced() -> None:
    """Where the whole process stands still, the clock jumps, and nothing is stuck."""
    release, entered = threading.Event(), threading.Event()

    class Slow(Resource):
        """Answers once it is let."""

        def get_value(self) -> int:
            entered.set()
            release.wait()
            return 7

    clock = ManualClock()
    with running_robot({"Slow": Slow, "Motor": partial(Motor, [])}, clock=clock) as robot:
        call = robot["Slow"].get_value(timeout_s=2.0)
        assert entered.wait(WAIT_S)
        clock.advance(60.0)
        robot["Motor"].send_cmd("exit").exception()
        assert eventually(lambda: robot.restarts)  # by now the robot has looked at the late resource
        release.set()
        assert isinstance(call.exception(), DeadlineError)
        assert call_until_up(robot["Slow"]) == 7
        clock.advance(60.0)
        assert call_until_up(robot["Motor"], clock) == 2
        assert robot.restarts == {"Motor": 1}


def test_closing_does_not_wait_for_what_is_stuck() -> None:
    notes: list[str] = []
    start_s = REAL_TIME.now()
    motor = Motor(notes)
    with running_robot({"Motor": lambda: motor}, close_timeout_s=0.3) as robot:
        call = robot["Motor"].send_cmd("spin", timeout_s=1000.0)
        assert motor.spinning.wait(WAIT_S)
    assert REAL_TIME.now() - start_s < WAIT_S
    with pytest.raises(UnavailableError, match="did not stop in time"):
        call.get()
    assert notes[-2:] == ["unwound", "halt"]


def test_a_resource_that_cannot_be_made_is_tried_again_and_then_fails_the_robot() -> None:
    tries: list[int] = []

    def make() -> Resource:
        tries.append(1)
        raise OSError("no such device")

    with running_robot({"Motor": make}, clock=ScaledClock(50), wait=False) as robot:
        with pytest.raises(RobotFailedError, match=r"more than 3 restarts.*OSError: no such device"):
            robot.wait_started(WAIT_S)
        assert len(tries) == 4
        with pytest.raises(RobotFailedError):
            robot["Motor"].get_value().get()


def test_plugins_that_cannot_connect_fail_the_robot_with_their_reason() -> None:
    def open_plugins() -> InlinePlugins:
        raise OSError("the bus is down")

    robot = RobotHandle(partial(start_robot, RobotSpec("robot", REAL_TIME, open_plugins)), "robot")
    with pytest.raises(RobotFailedError, match="robot: could not start: OSError: the bus is down"):
        robot.wait_started(WAIT_S)
    with pytest.raises(RobotFailedError):
        robot["Base"]
    robot.close()


def test_unknown_resources_are_named_with_the_nearest() -> None:
    with (
        running_robot({"Motor": partial(Motor, [])}) as robot,
        pytest.raises(ResourceNotFoundError, match="unknown resource 'Moter'; did you mean 'Motor'"),
    ):
        robot["Moter"]


def test_handles_survive_a_restart_of_what_they_name() -> None:
    clock = ManualClock()
    with running_robot({"Motor": partial(Motor, [])}, clock=clock) as robot:
        handle = robot["Motor"]
        info = handle.info
        handle.send_cmd("exit").exception()
        assert call_until_up(handle, clock) == 2
        assert handle.info == info
