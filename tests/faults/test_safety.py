"""Stops work whatever plugins, callers and signals do, and no motion continues unnoticed."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pykka
import pytest

from eal_actors.actors.combine import as_completed, gather
from eal_actors.actors.future import Future
from eal_actors.actors.handles import ResourceHandle
from eal_actors.actors.supervision import Restart
from eal_actors.device.info import ResourceType
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.clock import REAL_TIME, ScaledClock
from eal_actors.kernel.errors import (
    ArgumentError,
    DeadlineError,
    PreemptedError,
    ResourceFaultError,
    ResourceNotFoundError,
    ReturnTypeError,
    RobotFailedError,
)
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S, advance_until_done, running_robot


class Motor(Resource):
    """Notes what its motor does."""

    types = ResourceType.ACTUATOR

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.gate, self.entered = threading.Event(), threading.Event()
        self.halted = threading.Event()

    def get_value(self) -> int:
        return len(self.notes)

    def halt(self) -> None:
        self.notes.append("halt")
        self.halted.set()

    @command("drive")
    def drive(self) -> Activity:
        self.notes.append("on")
        try:
            yield 1000.0
        finally:
            self.notes.append("off")

    @command("slow on")
    def slow_on(self) -> None:
        self.entered.set()
        self.gate.wait(WAIT_S)
        self.notes.append("on")

    @command("on, then fail")
    def on_then_fail(self) -> None:
        self.notes.append("on")
        raise OSError("cable off")

    @command("bad yield")
    def bad_yield(self) -> Any:
        self.notes.append("on")
        try:
            yield 10**400
        finally:
            self.notes.append("off")

    @command("deaf")
    def deaf(self) -> Any:
        self.notes.append("on")
        while True:
            try:
                yield 1000.0
            except GeneratorExit:
                yield 1.0

    @command("spin")
    def spin(self) -> None:
        while True:
            self.gate.wait(0.001)

    @command("swallow")
    def swallow(self) -> None:
        self.entered.set()
        while not self.gate.wait(0.001):
            try:
                while not self.gate.wait(0.001):
                    pass
            except BaseException:  # noqa: BLE001  # as careless retry loops do
                return


def test_a_stop_that_comes_late_still_stops() -> None:
    motor, clock = Motor(), ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        handle = robot["Motor"]
        busy = handle.send_cmd("slow on", timeout_s=100.0)
        assert motor.entered.wait(WAIT_S)
        late, cancelled = handle.halt(timeout_s=1.0), handle.halt(timeout_s=50.0)
        assert cancelled.cancel()
        clock.advance(2.0)
        motor.gate.set()
        busy.get()
        handle.get_value().get()
        assert late.done()
        assert motor.notes == ["on", "halt", "halt"]


@pytest.mark.parametrize("give_up", [lambda call, _: call.cancel(), lambda _, clock: clock.advance(10.5)])
def test_what_an_ordinary_command_set_off_is_halted_when_nobody_waits_any_more(
    give_up: Callable[[Future[int], ManualClock], object],
) -> None:
    motor, clock = Motor(), ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        call = robot["Motor"].send_cmd("slow on", timeout_s=10.0)
        assert motor.entered.wait(WAIT_S)
        give_up(call, clock)
        if not call.done():
            call.expire()
        motor.gate.set()
        robot["Motor"].get_value().get()
        assert motor.notes == ["on", "halt"]


def test_what_an_ordinary_command_set_off_before_it_failed_is_halted() -> None:
    motor = Motor()
    with running_robot({"Motor": lambda: motor}) as robot:
        with pytest.raises(ResourceFaultError):
            robot["Motor"].send_cmd("on, then fail").get()
        assert motor.notes == ["on", "halt"]


def test_a_yield_that_is_no_time_ends_the_motion_in_order() -> None:
    motor = Motor()
    with running_robot({"Motor": lambda: motor}) as robot:
        with pytest.raises(ReturnTypeError):
            robot["Motor"].send_cmd("bad yield").get()
        assert motor.notes == ["on", "off", "halt"]


def test_an_activity_that_will_not_end_is_halted_before_the_next_command() -> None:
    motor = Motor()
    with running_robot({"Motor": lambda: motor}) as robot:
        deaf = robot["Motor"].send_cmd("deaf", timeout_s=1000.0)
        robot["Motor"].send_cmd("drive", timeout_s=1000.0)
        with pytest.raises(PreemptedError):
            deaf.get()
        robot["Motor"].get_status().exception()
        assert motor.notes == ["on", "halt", "on"]


def test_a_hang_that_nobody_waits_for_is_noticed() -> None:
    motor = Motor()
    with running_robot({"Motor": lambda: motor}, clock=ScaledClock(20), restart=Restart.TEMPORARY) as robot:
        robot["Motor"].send_cmd("spin", timeout_s=4.0)
        assert motor.halted.wait(WAIT_S)
        assert call_error(robot["Motor"], "stuck") is not None


def call_error(handle: ResourceHandle, words: str) -> BaseException | None:
    """Repeat a request until it fails with an error that contains the words."""
    end_s = REAL_TIME.now() + WAIT_S
    while REAL_TIME.now() < end_s:
        error = handle.get_value(timeout_s=1e6).exception()
        if error is not None and words in str(error):
            return error
    return None


def test_code_that_swallows_its_abandonment_is_halted_all_the_same() -> None:
    motor = Motor()
    with running_robot({"Motor": lambda: motor}, close_timeout_s=0.2) as robot:
        robot["Motor"].send_cmd("swallow", timeout_s=1000.0)
        assert motor.entered.wait(WAIT_S)
    assert motor.notes[-1] == "halt"


def test_pykkas_own_stop_halts_too() -> None:
    motor = Motor()

    class Foreign(pykka.ThreadingActor):
        def on_receive(self, message: Any) -> Any:
            raise SystemExit

    with running_robot({"Motor": lambda: motor}) as robot:
        drive = robot["Motor"].send_cmd("drive", timeout_s=1000.0)
        robot["Motor"].get_value().get()
        Foreign.start().tell("stop everything")
        with pytest.raises(PreemptedError):
            drive.get(timeout=WAIT_S)
        assert motor.halted.wait(WAIT_S)
    assert motor.notes == ["on", "off", "halt"]


def test_a_resource_that_ends_by_itself_is_restarted_if_it_is_permanent() -> None:
    lives: list[Motor] = []

    def make() -> Motor:
        lives.append(Motor())
        return lives[-1]

    with running_robot({"Motor": make}) as robot:
        (reference,) = [ref for ref in pykka.ActorRegistry.get_all() if ref.actor_class.__name__ == "ResourceActor"]
        reference.stop()
        end_s = REAL_TIME.now() + WAIT_S
        while robot["Motor"].get_value().exception() is not None or len(lives) < 2:
            assert REAL_TIME.now() < end_s
        assert robot.restarts == {"Motor": 1}


def test_closing_from_a_callback_of_the_robots_own_thread_stops_everything() -> None:
    motor, clock = Motor(), ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        drive = robot["Motor"].send_cmd("drive", timeout_s=1.0)
        closed = threading.Event()

        def close(_: object) -> None:
            robot.close()
            closed.set()

        drive.add_done_callback(close)
        advance_until_done(clock, drive, 0.25)
        assert closed.wait(WAIT_S)
        assert motor.halted.wait(WAIT_S)


def test_many_stuck_robots_close_together() -> None:
    from eal_actors.actors.handles import close_robots

    motors = [Motor() for _ in range(8)]
    start_s = REAL_TIME.now()
    with (
        running_robot({f"Motor{n}": lambda m=m: m for n, m in enumerate(motors[:4])}) as first,  # type: ignore[misc]
        running_robot({f"Motor{n}": lambda m=m: m for n, m in enumerate(motors[4:])}) as second,  # type: ignore[misc]
    ):
        for robot in (first, second):
            for name in robot:
                robot[name].send_cmd("spin", timeout_s=1000.0)
                robot[name].get_value(timeout_s=0.01).exception()
        close_robots([first, second], 0.4)
    assert REAL_TIME.now() - start_s < WAIT_S
    assert all("halt" in motor.notes for motor in motors)


def test_a_background_that_is_no_generator_fails_the_resource_by_name() -> None:
    class Wrong(Resource):
        """Returns a list."""

        def background(self) -> Any:
            return iter([0.1])

    with (
        running_robot({"Wrong": Wrong}, clock=ScaledClock(50), wait=False) as robot,
        pytest.raises(RobotFailedError, match=r"background returned .* which is no generator"),
    ):
        robot.wait_started(WAIT_S)


def test_close_is_called_only_after_a_good_open() -> None:
    notes: list[str] = []

    class Gone(Resource):
        """Its port is gone."""

        def open(self) -> None:
            notes.append("open")
            raise OSError("no port")

        def close(self) -> None:
            notes.append("close")

    with running_robot({"Gone": Gone}, max_restarts=0, wait=False) as robot, pytest.raises(RobotFailedError):
        robot.wait_started(WAIT_S)
    assert notes == ["open"]


def test_an_error_that_cannot_be_shown_is_still_an_answer() -> None:
    class EvilError(Exception):
        def __str__(self) -> str:
            raise ValueError("no words")

    class Sensor(Resource):
        """Raises it."""

        def get_value(self) -> int:
            raise EvilError

    with (
        running_robot({"Sensor": Sensor}) as robot,
        pytest.raises(ResourceFaultError, match="get_value raised EvilError"),
    ):
        robot["Sensor"].get_value().get()


@pytest.mark.parametrize("error", [SystemExit, asyncio.CancelledError])
def test_a_callback_that_exits_harms_nobody(error: type[BaseException]) -> None:
    def leave(_: object) -> None:
        raise error

    motor = Motor()
    with running_robot({"Motor": lambda: motor}) as robot:
        robot["Motor"].send_cmd("drive").add_done_callback(leave)
        assert robot["Motor"].halt().get() == 1  # the callback runs in the resource's thread
        assert robot["Motor"].get_value().exception() is None
        assert robot.restarts == {}


def test_a_deadline_that_is_no_number_is_refused() -> None:
    with running_robot({"Motor": Motor}) as robot, pytest.raises(ArgumentError, match="timeout_s"):
        robot["Motor"].get_value(timeout_s=float("nan"))


def test_deadline_and_cancellation_name_robot_and_resource() -> None:
    motor, clock = Motor(), ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        late = robot["Motor"].send_cmd("drive", timeout_s=2.0)
        advance_until_done(clock, late, 0.5)
        error = late.exception()
        assert isinstance(error, DeadlineError)
        assert (error.robot, error.resource) == ("robot", "Motor")
        assert str(error) == "robot/Motor: send_cmd 'drive' had no answer within its 2 s"


def test_a_gather_of_what_is_over_and_what_is_not_keeps_its_deadline() -> None:
    clock = ManualClock()
    with running_robot({"Motor": Motor}, clock=clock) as robot:
        drive = robot["Motor"].send_cmd("drive", timeout_s=1.0)
        both: Future[list[Any]] = gather([gather([]), drive])
        advance_until_done(clock, both, 0.25)
        assert isinstance(both.exception(), DeadlineError)


def test_a_gather_over_two_clocks_leaves_each_part_its_own_deadline() -> None:
    fast, slow = ManualClock(start_s=1000.0), ManualClock()
    with running_robot({"Motor": Motor}, clock=fast) as one, running_robot({"Motor": Motor}, clock=slow) as two:
        parts = [one["Motor"].send_cmd("drive", timeout_s=1.0), two["Motor"].send_cmd("drive", timeout_s=1.0)]
        both = gather(parts, return_exceptions=True)
        advance_until_done(fast, parts[0], 0.25)
        assert not parts[1].done()
        advance_until_done(slow, both, 0.25)
        assert [type(part.exception()) for part in parts] == [DeadlineError, DeadlineError]


def test_a_gather_that_cannot_be_made_gives_up_what_was_begun() -> None:
    motor = Motor()
    with running_robot({"Motor": lambda: motor}) as robot:
        with pytest.raises(ResourceNotFoundError):
            gather(robot[name].send_cmd("drive", timeout_s=1000.0) for name in ("Motor", "Arm"))
        robot["Motor"].get_status().exception()
        robot["Motor"].get_value().get()
        assert motor.notes in ([], ["on", "off", "halt"])


def test_mapped_calls_are_futures_like_any_other() -> None:
    motor, clock = Motor(), ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        doubled = robot["Motor"].get_value().map(lambda data: data.value * 2)
        assert gather([doubled]).get() == [0]
        assert doubled.done()
        failing = robot["Motor"].get_value().map(lambda _: 1 // 0)
        assert isinstance(failing.exception(), ZeroDivisionError)
        late = robot["Motor"].send_cmd("drive", timeout_s=1.0).map(lambda status: status)
        advance_until_done(clock, late, 0.25)
        assert isinstance(late.exception(), DeadlineError)
        assert robot["Motor"].send_cmd("drive").map(lambda status: status).cancel()


def test_as_completed_hears_of_deadlines() -> None:
    clock = ScaledClock(20)
    with running_robot({"Motor": Motor}, clock=clock) as robot:
        calls: list[Future[Any]] = [
            robot["Motor"].get_value(timeout_s=100.0),
            robot["Motor"].send_cmd("drive", timeout_s=4.0),
        ]
        outcomes = [type(call.exception()).__name__ for call in as_completed(calls)]
    assert outcomes == ["NoneType", "DeadlineError"]


def test_asking_whether_a_failed_robot_has_a_resource_is_no_error() -> None:
    def make() -> Resource:
        raise OSError("no")

    with running_robot({"Motor": make}, max_restarts=0, wait=False) as robot:
        with pytest.raises(RobotFailedError):
            robot.wait_started(WAIT_S)
        assert "Pose" not in robot
