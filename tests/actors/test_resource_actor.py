from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Activity, Resource, command, config, config_setter, request
from eal_actors.kernel.errors import (
    ArgumentError,
    BusyError,
    CallCancelledError,
    DeadlineError,
    PreemptedError,
    ResourceFaultError,
    ReturnTypeError,
    UnavailableError,
    UnsupportedError,
)
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S, advance_until_done, running_robot


class Base(Resource):
    """A motor that notes what happens to it."""

    types = ResourceType.ACTUATOR | ResourceType.SENSOR
    value = ValueInfo(DataType.INT)

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.threads: set[str] = set()
        self.gate = threading.Event()
        self.entered = threading.Event()
        self.speed = 1.0

    def get_status(self) -> int:
        return 7

    def get_value(self) -> int:
        self.threads.add(threading.current_thread().name)
        return len(self.notes)

    def halt(self) -> None:
        self.notes.append("halt")

    @command("go<metres>", ValueInfo(DataType.DOUBLE, unit="m", minimum=0, maximum=10))
    def go(self, metres: float) -> Activity:
        self.notes.append(f"start {metres:g}")
        try:
            yield metres
            self.notes.append(f"arrived {metres:g}")
        finally:
            self.notes.append("motors off")

    @command("s", urgent=True)
    def stop(self) -> None:
        self.notes.append("stop")

    @command("beep")
    def beep(self) -> int:
        self.notes.append("beep")
        return 3

    @command("block")
    def block(self) -> None:
        self.entered.set()
        self.gate.wait(WAIT_S)

    @command("fall")
    def fall(self) -> Activity:
        yield 0.0
        raise OSError("cable off")

    @command("odd")
    def odd(self) -> Any:
        return "fine"

    @command("odd yield")
    def odd_yield(self) -> Any:
        yield "soon"

    @request("double", ValueInfo(DataType.DOUBLE))
    def double(self) -> float:
        return self.speed * 2

    @request("liar", ValueInfo(DataType.DOUBLE))
    def liar(self) -> str:
        return "two"

    @config("speed", ValueInfo(DataType.DOUBLE, unit="m/s", minimum=0, maximum=2))
    def get_speed(self) -> float:
        return self.speed

    @config_setter("speed")
    def set_speed(self, value: float) -> None:
        self.speed = value


class Quiet(Resource):
    """Supports nothing."""


@pytest.fixture
def base() -> Base:
    return Base()


def test_calls_answer_with_eal_data_and_status_ints(base: Base) -> None:
    with running_robot({"Base": lambda: base}) as robot:
        handle = robot["Base"]
        assert handle.get_status().get() == 7
        assert handle.get_value().get() == EALData.of(0)
        assert handle.send_cmd("beep").get() == 3
        assert handle.send_cmd("s").get() == 1
        assert handle.send_req("double").get().value == 2.0
        assert handle.set_config("speed", 1.5).get() == 1
        assert handle.get_config("speed").get().value == 1.5
        assert base.threads == {"robot/Base"}


def test_unsupported_methods_name_resource_and_method() -> None:
    with running_robot({"Quiet": Quiet}) as robot:
        handle = robot["Quiet"]
        calls: dict[str, Callable[[], Any]] = {
            "get_status": handle.get_status,
            "get_value": handle.get_value,
            "set_value": lambda: handle.set_value(1),
            "send_req": lambda: handle.send_req("x"),
            "send_cmd": lambda: handle.send_cmd("x"),
            "read_comm": lambda: handle.read_comm(1),
            "write_comm": lambda: handle.write_comm(b"x"),
            "get_config": lambda: handle.get_config("x"),
            "set_config": lambda: handle.set_config("x", 1),
        }
        for method, call in calls.items():
            with pytest.raises(UnsupportedError, match=f"robot/Quiet: Quiet does not support {method}"):
                call().get()


def test_an_activity_leaves_the_mailbox_free_and_resolves_its_future(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        drive = robot["Base"].send_cmd("go2")
        assert robot["Base"].get_status().get() == 7
        assert not drive.done()
        advance_until_done(clock, drive, 0.5)
        assert drive.get() == 1
        assert base.notes == ["start 2", "arrived 2", "motors off"]


def test_a_newer_command_closes_the_running_one_first(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        drive = robot["Base"].send_cmd("go5")
        assert robot["Base"].send_cmd("beep").get() == 3
        with pytest.raises(PreemptedError, match="beep"):
            drive.get()
        assert base.notes == ["start 5", "motors off", "beep"]


def test_a_command_that_is_refused_does_not_stop_the_running_one(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        drive = robot["Base"].send_cmd("go1")
        for bad in ("go99", "dance", "gox"):
            with pytest.raises(ArgumentError):
                robot["Base"].send_cmd(bad).get()
        advance_until_done(clock, drive, 0.5)
        assert drive.get() == 1


def test_halt_closes_the_motion_and_drops_the_motions_that_wait(base: Base) -> None:
    with running_robot({"Base": lambda: base}) as robot:
        handle = robot["Base"]
        blocked = handle.send_cmd("block")
        assert base.entered.wait(WAIT_S)
        waiting = [handle.send_cmd("go1"), handle.send_cmd("go2")]
        reading = handle.get_value()
        halted = handle.halt()
        after = handle.send_cmd("beep")
        base.gate.set()
        assert halted.get() == 1
        assert blocked.get() == 1
        for call in waiting:
            with pytest.raises(PreemptedError, match="dropped by halt"):
                call.get()
        assert reading.get().value == 1
        assert after.get() == 3
        assert base.notes == ["halt", "beep"]


def test_an_urgent_command_overtakes_and_drops_too(base: Base) -> None:
    with running_robot({"Base": lambda: base}) as robot:
        handle = robot["Base"]
        handle.send_cmd("block")
        assert base.entered.wait(WAIT_S)
        waiting = handle.send_cmd("go1")
        stopped = handle.send_cmd("s")
        base.gate.set()
        assert stopped.get() == 1
        with pytest.raises(PreemptedError, match="dropped by send_cmd 's'"):
            waiting.get()
        assert base.notes == ["stop"]


def test_status_overtakes_what_waits(base: Base) -> None:
    with running_robot({"Base": lambda: base}) as robot:
        handle = robot["Base"]
        handle.send_cmd("block")
        assert base.entered.wait(WAIT_S)
        order: list[str] = []
        handle.send_cmd("beep").add_done_callback(lambda _: order.append("beep"))
        status = handle.get_status()
        status.add_done_callback(lambda _: order.append("status"))
        base.gate.set()
        handle.get_value().get()
        assert order == ["status", "beep"]


def test_a_full_mailbox_answers_busy_at_once(base: Base) -> None:
    with running_robot({"Base": lambda: base}, mailbox=2) as robot:
        handle = robot["Base"]
        handle.send_cmd("block")
        assert base.entered.wait(WAIT_S)
        waiting = [handle.get_value(), handle.get_value()]
        refused = handle.get_value()
        assert refused.done()
        with pytest.raises(BusyError, match=r"robot/Base: its mailbox is full \(2 calls wait\)"):
            refused.get()
        base.gate.set()
        assert [call.get().value for call in waiting] == [0, 0]


def test_what_the_resource_raises_is_named_and_halts_a_motion(base: Base) -> None:
    with running_robot({"Base": lambda: base}) as robot:
        with pytest.raises(ResourceFaultError, match="robot/Base: send_cmd 'fall' raised OSError: cable off") as caught:
            robot["Base"].send_cmd("fall").get()
        assert isinstance(caught.value.__cause__, OSError)
        assert base.notes == ["halt"]
        assert robot["Base"].get_value().get().value == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda base: base.send_cmd("odd"), "send_cmd 'odd' returned 'fine' where a status int is wanted"),
        (lambda base: base.send_cmd("odd yield"), "yielded 'soon' where seconds"),
        (lambda base: base.send_req("liar"), "send_req 'liar' returned a value that must be double"),
    ],
)
def test_wrong_types_are_named(base: Base, call: Callable[[Any], Any], message: str) -> None:
    with running_robot({"Base": lambda: base}) as robot, pytest.raises(ReturnTypeError, match=message):
        call(robot["Base"]).get()


def test_a_value_that_no_data_can_hold_is_a_return_type_error() -> None:
    class Wrong(Resource):
        """Returns what it may not."""

        def get_value(self) -> Any:
            return object()

    with (
        running_robot({"Wrong": Wrong}) as robot,
        pytest.raises(ReturnTypeError, match="robot/Wrong: get_value returned what no EALData can hold"),
    ):
        robot["Wrong"].get_value().get()


def test_a_call_that_waits_beyond_its_deadline_is_not_executed(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        handle = robot["Base"]
        handle.send_cmd("block", timeout_s=5.0)
        assert base.entered.wait(WAIT_S)
        late = handle.send_cmd("beep", timeout_s=1.0)
        clock.advance(1.5)
        base.gate.set()
        handle.get_status().get()
        with pytest.raises(DeadlineError):
            late.get()
        assert "beep" not in base.notes


def test_a_motion_beyond_its_deadline_is_closed_and_halted(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        drive = robot["Base"].send_cmd("go10", timeout_s=1.0)
        advance_until_done(clock, drive, 0.25)
        with pytest.raises(DeadlineError, match="send_cmd 'go10'"):
            drive.get()
        robot["Base"].get_status().get()
        assert base.notes[:3] == ["start 10", "motors off", "halt"]


def test_cancelling_the_future_stops_the_motion(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        drive = robot["Base"].send_cmd("go5")
        robot["Base"].get_status().get()
        assert drive.cancel()
        robot["Base"].get_status().get()
        with pytest.raises(CallCancelledError):
            drive.get()
        assert base.notes == ["start 5", "motors off", "halt"]


def test_closing_the_robot_stops_what_moves_and_fails_what_waits(base: Base) -> None:
    clock = ManualClock()
    with running_robot({"Base": lambda: base}, clock=clock) as robot:
        handle = robot["Base"]
        drive = handle.send_cmd("go5")
        handle.get_status().get()
    with pytest.raises(PreemptedError):
        drive.get()
    with pytest.raises(UnavailableError, match="robot/Base: the robot is disconnected"):
        handle.get_value().get()
    assert base.notes == ["start 5", "motors off", "halt"]


def test_a_background_activity_runs_between_calls() -> None:
    clock = ManualClock()
    polled = threading.Event()

    class Poller(Resource):
        """Polls."""

        def __init__(self) -> None:
            self.polls = 0

        def background(self) -> Activity:
            while True:
                self.polls += 1
                if self.polls == 3:
                    polled.set()
                yield 0.5

        def get_value(self) -> int:
            return self.polls

    with running_robot({"Poller": Poller}, clock=clock) as robot:
        assert robot["Poller"].get_value().get().value >= 0
        while not polled.wait(0.002):
            clock.advance(0.25)
            assert clock.now() < 60
        assert robot["Poller"].get_value().get().value >= 3


def test_an_unsupported_call_stops_nothing() -> None:
    class Driver(Resource):
        """Takes its commands by itself, and no values."""

        types = ResourceType.ACTUATOR

        def send_cmd(self, cmd: str, data: EALData | None = None) -> Activity:
            yield 1.0

    class Dial(Resource):
        """Takes values over time, and no commands."""

        types = ResourceType.ACTUATOR

        def set_value(self, data: EALData) -> Activity:
            yield 1.0

    clock = ManualClock()
    with running_robot({"Driver": Driver, "Dial": Dial}, clock=clock) as robot:
        drive, turn = robot["Driver"].send_cmd("go"), robot["Dial"].set_value(3)
        for refused in (robot["Driver"].set_value(1), robot["Dial"].send_cmd("go")):
            with pytest.raises(UnsupportedError):
                refused.get()
        for motion in (drive, turn):
            advance_until_done(clock, motion, 0.5)
            assert motion.get() == 1
