"""read_comm and write_comm that wait: beside a motion and beside one another."""

from __future__ import annotations

from typing import Any

import pytest

from eal_actors.actors.future import Future
from eal_actors.actors.resource_handle import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceType
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.errors import (
    CallCancelledError,
    DeadlineError,
    PreemptedError,
    ResourceFaultError,
    ReturnTypeError,
    UnsupportedError,
)
from tests.manual_clock import ManualClock
from tests.robots import advance_until_done, running_robot


class Radio(Resource):
    """A line that moves too."""

    types = ResourceType.COMMUNICATION | ResourceType.ACTUATOR

    def __init__(self) -> None:
        self.notes: list[str] = []

    def get_status(self) -> int:
        return len(self.notes)

    def halt(self) -> None:
        self.notes.append("halt")

    def read_comm(self, length: int) -> Any:
        try:
            yield float(length)
            if length == 3:
                raise OSError("noise")
            return object() if length == 4 else b"x" * length
        finally:
            self.notes.append(f"read {length} ends")

    def write_comm(self, data: EALData, length: int) -> Any:
        try:
            yield float(length)
            return length
        finally:
            self.notes.append(f"write {length} ends")

    @command("go")
    def go(self) -> Activity:
        try:
            yield 2.5
        finally:
            self.notes.append("go ends")


def has_begun(handle: ResourceHandle) -> None:
    """Wait until everything that was sent before has begun."""
    assert isinstance(handle.get_value().exception(), UnsupportedError)  # in its turn


@pytest.fixture
def radio() -> Radio:
    return Radio()


def test_reads_go_on_beside_a_motion_and_beside_one_another(radio: Radio) -> None:
    clock = ManualClock()
    with running_robot({"Radio": lambda: radio}, clock=clock) as robot:
        handle = robot["Radio"]
        calls: list[Future[Any]] = [
            handle.read_comm(2),
            handle.send_cmd("go"),
            handle.read_comm(1),
            handle.write_comm("hello"),
        ]
        has_begun(handle)
        for call in calls:
            advance_until_done(clock, call, 0.1)
        assert [call.get() for call in calls] == [EALData.of(b"xx"), 1, EALData.of(b"x"), 5]
        assert radio.notes == ["read 1 ends", "read 2 ends", "go ends", "write 5 ends"]


def test_a_halt_ends_motion_and_writing_but_no_reading(radio: Radio) -> None:
    clock = ManualClock()
    with running_robot({"Radio": lambda: radio}, clock=clock) as robot:
        handle = robot["Radio"]
        reading, moving, writing = handle.read_comm(1), handle.send_cmd("go"), handle.write_comm("hello")
        has_begun(handle)
        assert handle.halt().get() == 1
        for call in (moving, writing):
            assert isinstance(call.exception(), PreemptedError)
        assert radio.notes == ["go ends", "write 5 ends", "halt"]
        advance_until_done(clock, reading)
        assert reading.get().value == b"x"


def test_a_read_that_nobody_waits_for_ends_and_halts_nothing(radio: Radio) -> None:
    clock = ManualClock()
    with running_robot({"Radio": lambda: radio}, clock=clock) as robot:
        handle = robot["Radio"]
        moving, late, unwanted = handle.send_cmd("go"), handle.read_comm(100, timeout_s=1), handle.read_comm(50)
        has_begun(handle)
        unwanted.cancel()
        advance_until_done(clock, late, 0.1)
        assert isinstance(late.exception(), DeadlineError)
        assert isinstance(unwanted.exception(), CallCancelledError)
        assert handle.get_status().get() == 2
        assert sorted(radio.notes) == ["read 100 ends", "read 50 ends"]
        assert not moving.done()


def test_a_failing_read_fails_alone(radio: Radio) -> None:
    clock = ManualClock()
    with running_robot({"Radio": lambda: radio}, clock=clock) as robot:
        handle = robot["Radio"]
        odd, noisy = handle.read_comm(4, timeout_s=9), handle.read_comm(3, timeout_s=9)
        advance_until_done(clock, odd)
        with pytest.raises(ReturnTypeError, match="read_comm 4 returned what no EALData can hold"):
            odd.get()
        with pytest.raises(ResourceFaultError, match="read_comm 3 raised OSError: noise"):
            noisy.get()
        assert "halt" not in radio.notes
        assert robot.restarts == {}


def test_closing_ends_them(radio: Radio) -> None:
    with running_robot({"Radio": lambda: radio}) as robot:
        reading, writing = robot["Radio"].read_comm(60, timeout_s=99), robot["Radio"].write_comm("x" * 60, timeout_s=99)
        has_begun(robot["Radio"])
    for call in (reading, writing):
        assert isinstance(call.exception(), PreemptedError)
    assert sorted(radio.notes) == ["halt", "read 60 ends", "write 60 ends"]
