"""Waiting for and observing a robot's state."""

from __future__ import annotations

import threading
from typing import cast

import pytest

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotConnection, RobotState, RobotView
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import ArgumentError, DeadlineError, EALError, UnavailableError
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S, running_robot


class Slow(Resource):
    """Opens when it is let."""

    gate = threading.Event()

    def open(self) -> None:
        assert self.gate.wait(WAIT_S)


@pytest.fixture(autouse=True)
def gate() -> threading.Event:
    Slow.gate = threading.Event()
    return Slow.gate


def test_callbacks_hear_of_each_state(gate: threading.Event) -> None:
    states: list[RobotState] = []
    missed: list[RobotState] = []
    with running_robot({"Slow": Slow}, wait=False) as robot:
        robot.on_state(states.append)
        end = robot.on_state(missed.append)
        end()
        end()
        ready = robot.wait_for_state(RobotState.READY, WAIT_S)
        assert not ready.done()
        gate.set()
        assert ready.get() is RobotState.READY
        assert robot.wait_for_state(RobotState.READY, WAIT_S).done()  # it is
        stopped = robot.wait_for_state(RobotState.STOPPED, WAIT_S)
    assert stopped.get() is RobotState.STOPPED
    assert states == [RobotState.STARTING, RobotState.READY, RobotState.STOPPED]
    assert missed == [RobotState.STARTING]


def test_a_callback_that_raises_disturbs_nobody(gate: threading.Event) -> None:
    states: list[RobotState] = []

    def fail(_: RobotState) -> None:
        raise ZeroDivisionError

    with running_robot({"Slow": Slow}, wait=False) as robot:
        robot.on_state(fail)
        robot.on_state(states.append)
        gate.set()
        robot.wait_for_state(RobotState.READY, WAIT_S).get()
    assert states[-1] is RobotState.STOPPED


def test_waiting_ends_with_the_deadline_and_says_what_it_is_instead(gate: threading.Event) -> None:
    clock = ManualClock()
    with running_robot({"Slow": Slow}, clock=clock, wait=False) as robot:
        wait = robot.wait_for_state(RobotState.READY, 2.0)
        over = threading.Event()
        wait.add_done_callback(lambda _: over.set())
        while not over.wait(0.002):
            clock.advance(0.5)
        error = wait.exception()
        assert isinstance(error, DeadlineError)
        assert str(error) == "robot: still starting, not ready, after 2 s"
        gate.set()


def test_waiting_ends_where_the_state_can_never_come(gate: threading.Event) -> None:
    gate.set()
    waits: list[Future[RobotState]] = []
    with running_robot({"Slow": Slow}) as robot:
        waits.append(robot.wait_for_state(RobotState.LOST, WAIT_S))
    error = waits[0].exception(timeout=WAIT_S)
    assert isinstance(error, UnavailableError)
    assert "it is stopped, and cannot become lost any more" in str(error)


def test_a_robot_that_comes_back_as_it_is_asked_why_it_is_out_of_reach_is_only_out_of_reach() -> None:
    class View:
        """Of a robot that comes back once somebody has read its problems."""

        def __init__(self) -> None:
            self.cells: dict[str, object] = {}
            self.state = RobotState.LOST
            self.readings = iter([(UnavailableError("does not answer"),)])

        @property
        def problems(self) -> tuple[EALError, ...]:
            return next(self.readings, ())

    view = cast("RobotView", View())
    robot = RobotHandle(lambda: (cast("RobotConnection", None), view), "evbot")
    for message in ("does not answer", "has not started yet"):
        with pytest.raises(UnavailableError, match=message):
            robot["Base"]


def test_a_time_that_is_no_number_of_seconds_is_refused(gate: threading.Event) -> None:
    gate.set()
    with running_robot({"Slow": Slow}) as robot, pytest.raises(ArgumentError, match="must be seconds, not nan"):
        robot.wait_for_state(RobotState.STOPPED, float("nan"))
