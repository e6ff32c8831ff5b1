"""A resource whose device is away refuses calls at once, and works again when it is back."""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Iterator
from functools import partial

import pytest

from eal_actors.actors.readiness import READINESS_PERIOD_S
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceType
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.errors import (
    NotReadyError,
    PreemptedError,
    ResourceFaultError,
    RobotFailedError,
    UnavailableError,
)
from eal_actors.kernel.log import configure_logging
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S, running_robot


class Motor(Resource):
    """A motor on a cable that can be pulled out."""

    types = ResourceType.SENSOR | ResourceType.ACTUATOR

    def __init__(self) -> None:
        self.reason: str | None = None
        self.is_broken = False
        self.asked = threading.Event()
        self.halted = threading.Event()
        self.absent: str | None = None
        self.notes: list[str] = []

    def not_ready(self) -> str | None:
        if self.is_broken:
            raise ZeroDivisionError("a bug")
        self.asked.set()
        return self.reason

    def get_value(self) -> int:
        self.notes.append("get_value")
        return 5

    def halt(self) -> None:
        if self.absent:
            raise NotReadyError(self.absent)
        self.notes.append("halt")
        self.halted.set()

    @command("go")
    def go(self) -> Activity:
        self.notes.append("go")
        yield 1.0

    @command("turn")
    def turn(self) -> Activity:
        self.notes.append("turn")
        try:
            while True:
                yield 0.5
                if self.absent:
                    raise NotReadyError(self.absent)
        finally:
            self.halt()

    @command("s", urgent=True)
    def stop(self) -> None:
        if self.absent:
            raise NotReadyError(self.absent)
        self.notes.append("stop")


@pytest.fixture
def motor() -> Motor:
    return Motor()


@pytest.fixture
def log() -> Iterator[io.StringIO]:
    lines = io.StringIO()
    configure_logging("json", "info", lines)
    yield lines
    configure_logging(level="warning")


def test_calls_are_refused_at_once_and_reach_no_code(motor: Motor) -> None:
    with running_robot({"Motor": lambda: motor}) as robot:
        motor.reason = "cannot open /dev/ttyUSB0: no such file or directory"
        for call in (robot["Motor"].get_value(), robot["Motor"].send_cmd("go")):
            with pytest.raises(NotReadyError) as caught:
                call.get()
            assert str(caught.value) == "robot/Motor: cannot open /dev/ttyUSB0: no such file or directory"
            assert isinstance(caught.value, UnavailableError)
        assert motor.notes == []
        motor.reason = None
        assert robot["Motor"].get_value().get() == EALData.of(5)
        assert robot.restarts == {}


def test_a_reason_is_shown_as_text(motor: Motor) -> None:
    with running_robot({"Motor": lambda: motor}) as robot:
        motor.reason = OSError("unplugged")  # type: ignore[assignment]  # the answer to a handshake contains it
        with pytest.raises(NotReadyError, match="unplugged"):
            robot["Motor"].get_value().get()
        assert robot.not_ready == {"Motor": "unplugged"}


def test_halts_and_stops_get_through_whatever_it_says(motor: Motor) -> None:
    with running_robot({"Motor": lambda: motor}) as robot:
        go = robot["Motor"].send_cmd("go")
        assert robot["Motor"].get_value().get().value == 5
        motor.reason = "away"
        assert robot["Motor"].send_cmd("s").get() == 1
        assert robot["Motor"].halt().get() == 1
        with pytest.raises(PreemptedError):
            go.get()
        assert motor.notes == ["go", "get_value", "stop", "halt"]


def pass_periods_until(event: threading.Event, clock: ManualClock) -> None:
    """Let time pass; a period at a time, since the actor may not have begun to wait for the next one."""
    for _ in range(int(WAIT_S / 0.05)):
        clock.advance(READINESS_PERIOD_S)
        if event.wait(0.05):
            return
    raise AssertionError("it did not happen")


def test_a_halt_without_the_device_is_accepted_and_runs_when_it_is_back(motor: Motor, log: io.StringIO) -> None:
    clock = ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        for method in ("halt", "s"):
            motor.reason = motor.absent = "unplugged"
            stop = robot["Motor"].halt() if method == "halt" else robot["Motor"].send_cmd(method)
            assert stop.get() == 1
            assert motor.notes == []
            motor.asked.clear()
            motor.halted.clear()
            pass_periods_until(motor.asked, clock)
            assert motor.notes == []  # it is still away
            motor.reason = motor.absent = None
            pass_periods_until(motor.halted, clock)
            robot["Motor"].get_value().get()
            assert motor.notes == ["halt", "get_value"]  # once
            motor.notes.clear()
        motor.reason = motor.absent = "unplugged"
        assert robot["Motor"].halt().get() == 1
        motor.reason = motor.absent = None
        robot["Motor"].send_cmd("go")
        robot["Motor"].get_value().get()
        assert motor.notes == ["halt", "go", "get_value"]  # before anything newer
    assert log.getvalue().count("it is halted as soon as it is ready") == 3


def test_a_motion_that_lost_its_device_is_halted_when_it_is_back(motor: Motor, log: io.StringIO) -> None:
    clock = ManualClock()
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        going = robot["Motor"].send_cmd("turn")
        robot["Motor"].get_value().get()
        motor.reason = motor.absent = "unplugged"
        clock.advance(1.0)
        with pytest.raises(NotReadyError, match="unplugged"):
            going.get()
        assert motor.notes == ["turn", "get_value"]
        motor.reason = motor.absent = None
        robot["Motor"].get_value().get()
        assert motor.notes == ["turn", "get_value", "halt", "get_value"]
    assert "cleaning up failed" not in log.getvalue()


def test_the_log_of_the_end_without_the_device_has_only_halts_that_are_owed(motor: Motor, log: io.StringIO) -> None:
    for is_halted in (False, True):
        with running_robot({"Motor": lambda: motor}) as robot:
            motor.reason = motor.absent = "unplugged"
            with pytest.raises(NotReadyError):
                robot["Motor"].get_value().get()
            if is_halted:
                robot["Motor"].halt().get()
        assert ("closed before it could be halted" in log.getvalue()) == is_halted
    assert '"level": "error"' not in log.getvalue()


def test_a_robot_says_which_resources_are_not_ready_and_why(motor: Motor, log: io.StringIO) -> None:
    clock = ManualClock()
    motor.reason = "away"
    with running_robot({"Motor": lambda: motor}, clock=clock) as robot:
        assert robot.not_ready == {"Motor": "away"}  # from the start on, before anybody calls
        assert robot.ping().get().not_ready == {"Motor": "away"}
        motor.reason = "still away"
        motor.asked.clear()
        clock.advance(READINESS_PERIOD_S)
        assert motor.asked.wait(WAIT_S)  # it is asked now and again
        robot["Motor"].halt().get()
        assert robot.not_ready == {"Motor": "still away"}
        motor.reason = None
        assert robot["Motor"].get_value().get().value == 5
        assert robot.not_ready == {}
    said = [line for line in log.getvalue().splitlines() if "ready" in line]
    assert [('"not ready"' in line, '"ready again"' in line) for line in said] == [(True, False), (False, True)]
    assert '"reason": "away"' in said[0]


def test_a_reason_of_many_resources_is_logged_once(log: io.StringIO) -> None:
    motors = [Motor() for _ in range(4)]
    for motor, reason in zip(motors, ["no port", "no port", "no port", "no camera"], strict=True):
        motor.reason = reason
    with running_robot({f"Motor{n}": partial(motors.__getitem__, n) for n in range(4)}) as robot:
        assert len(robot.not_ready) == 4
    said = [json.loads(line) for line in log.getvalue().splitlines() if '"not ready"' in line]
    assert sorted(line["reason"] for line in said) == ["no camera", "no port"]


def test_a_bug_in_it_fails_the_call_and_is_named(motor: Motor) -> None:
    with running_robot({"Motor": lambda: motor}) as robot:
        motor.is_broken = True
        with pytest.raises(ResourceFaultError, match="get_value raised ZeroDivisionError: a bug"):
            robot["Motor"].get_value().get()


def test_a_bug_in_it_at_the_start_is_a_crash_with_its_reason(motor: Motor) -> None:
    motor.is_broken = True
    with (
        pytest.raises(RobotFailedError, match="Motor crashed with ZeroDivisionError: a bug"),
        running_robot({"Motor": lambda: motor}, max_restarts=0),
    ):
        pass
