"""Values, requests and configuration that take time, as activities beside one another."""

from __future__ import annotations

import pytest

from eal_actors.actors.future import Future
from eal_actors.device.data import DataType
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Activity, Resource, command, config, config_setter, request
from eal_actors.kernel.clock import ScaledClock
from eal_actors.kernel.errors import DeadlineError, ReturnTypeError, UnavailableError
from tests.manual_clock import ManualClock
from tests.robots import running_robot

_LEVEL = ValueInfo(DataType.INT, "cm", 0, 100)


class Tank(Resource):
    """A tank whose level is known when the water rests."""

    types = ResourceType.SENSOR | ResourceType.ACTUATOR
    value = _LEVEL

    def __init__(self) -> None:
        self.level: object = None
        self.notes: list[str] = []

    def get_value(self) -> Activity:
        try:
            while self.level is None:
                yield 1.0
        finally:
            self.notes.append("value over")
        return self.level

    @request("level", _LEVEL)
    def ask_level(self) -> Activity:
        return self.get_value()

    @config("limit", _LEVEL)
    def limit(self) -> Activity:
        return self.get_value()

    @config_setter("limit")
    def set_limit(self, limit: int) -> Activity:
        while self.level is None:
            yield 1.0
        if self.level != limit:
            raise UnavailableError(f"it is {self.level}")

    @command("fill")
    def fill(self) -> Activity:
        try:
            yield 1000.0
        finally:
            self.notes.append("filled")

    def halt(self) -> None:
        self.notes.append("halt")

    def get_status(self) -> int:
        return 3


def test_calls_that_wait_stand_beside_one_another_and_disturb_no_motion() -> None:
    clock, tank = ManualClock(), Tank()
    with running_robot({"Tank": lambda: tank}, clock=clock, timeout_s=50.0) as robot:
        handle = robot["Tank"]
        fill: Future[int] = handle.send_cmd("fill", timeout_s=5000.0)
        waiting = [handle.get_value(), handle.get_value(), handle.send_req("level"), handle.get_config("limit")]
        kept, refused = handle.set_config("limit", 7), handle.set_config("limit", 8)
        handle.send_req("nobody").exception()  # refused, when all have begun
        assert handle.get_status().get() == 3  # answered meanwhile
        assert not any([*(one.done() for one in waiting), kept.done(), refused.done(), fill.done()])
        tank.level = 7
        clock.advance(1.0)
        assert [one.get().value for one in waiting] == [7] * 4
        assert kept.get() == 1
        assert isinstance(refused.exception(), UnavailableError)
        assert not fill.done()
        assert "halt" not in tank.notes


def test_a_halt_does_not_end_them() -> None:
    clock, tank = ManualClock(), Tank()
    with running_robot({"Tank": lambda: tank}, clock=clock, timeout_s=50.0) as robot:
        asked = robot["Tank"].get_value()
        robot["Tank"].send_req("nobody").exception()  # refused, when it has begun
        robot["Tank"].halt().get()
        assert not asked.done()
        tank.level = 1
        clock.advance(1.0)
        assert asked.get().value == 1


def test_a_deadline_closes_them_and_halts_nothing() -> None:
    clock, tank = ManualClock(), Tank()
    with running_robot({"Tank": lambda: tank}, clock=clock, timeout_s=50.0) as robot:
        asked = robot["Tank"].get_value(timeout_s=2.5)
        robot["Tank"].send_req("nobody").exception()  # refused, when it has begun
        clock.advance(2.5)
        assert isinstance(asked.exception(), DeadlineError)
        assert robot["Tank"].get_status().get() == 3
        assert tank.notes == ["value over"]


def test_what_they_give_is_checked_against_what_was_promised() -> None:
    tank = Tank()
    tank.level = 200
    with running_robot({"Tank": lambda: tank}) as robot:
        with pytest.raises(ReturnTypeError, match=r"get_value returned a value that must be int 0\.\.100 cm, not 200"):
            robot["Tank"].get_value().get()
        with pytest.raises(ReturnTypeError, match="send_req 'level' returned a value"):
            robot["Tank"].send_req("level").get()


def _nested(depth: int) -> list[object]:
    nested: list[object] = []
    for _ in range(depth):
        nested = [nested]
    return nested


@pytest.mark.parametrize("status", [2**70, -(2**63) - 1, _nested(5000), "x" * 100_000])
def test_a_status_that_no_message_can_carry_fails_its_command_at_once(status: object) -> None:
    class Odd(Resource):
        """Returns what it may not."""

        types = ResourceType.ACTUATOR

        def halt(self) -> None:
            """Do nothing."""

        @command("now")
        def now(self) -> object:
            """Return it at once."""
            return status

        @command("later")
        def later(self) -> Activity:
            """Return it after a step."""
            yield 0.0
            return status

    with running_robot({"Odd": Odd}) as robot:
        for name in ("now", "later"):
            with pytest.raises(ReturnTypeError, match=f"send_cmd '{name}' returned .* where a status int") as caught:
                robot["Odd"].send_cmd(name).get(timeout=5)
            assert len(str(caught.value)) < 300


def test_the_deadline_of_a_fast_clock_is_named_in_real_time_too() -> None:
    with running_robot({"Tank": Tank}, clock=ScaledClock(100.0)) as robot:
        error = robot["Tank"].get_value(timeout_s=2.0).exception()
        assert str(error) == "robot/Tank: get_value had no answer within its 2 s, 0.02 s of real time"
