"""Waiting calls in a resource's mailbox: a real actor under a stopped clock, compared with a model.

The actor is held inside a request while calls come, time passes and callers give up. When it is let go, what it runs,
in which order, and every caller's outcome must match the model.
"""

from __future__ import annotations

import itertools
import threading
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from eal_actors.actors.future import Future
from eal_actors.device.data import DataType
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Resource, command, request
from eal_actors.kernel.errors import (
    BusyError,
    CallCancelledError,
    DeadlineError,
    EALError,
    PreemptedError,
    StaleCommandError,
)
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S, running_robot

CAPACITY = 3
DONE = 1


class Turnstile(Resource):
    """Writes down what runs; a request holds the actor until the gate is open."""

    types = ResourceType.ACTUATOR | ResourceType.SENSOR

    def __init__(self) -> None:
        self.ran: list[str] = []
        self.entered = threading.Event()
        self.gate = threading.Event()

    def get_status(self) -> int:
        self.ran.append("status")
        return DONE

    def get_value(self) -> int:
        self.ran.append("value")
        return DONE

    @command("go<number>", ValueInfo(DataType.INT))
    def go(self, number: int) -> int:
        """Move in no time."""
        self.ran.append(f"go{number}")
        return DONE

    @request("hold")
    def hold(self) -> int:
        """Hold everything up."""
        self.entered.set()
        if not self.gate.wait(WAIT_S):
            raise TimeoutError("nobody opened the gate")
        return DONE

    def halt(self) -> None:
        self.ran.append("halt")


@dataclass(eq=False)
class Waiting:
    """A call as the model sees it."""

    what: str
    future: Future[Any]
    deadline_s: float
    begin_by_s: float
    moves: bool = False
    stops: bool = False
    error: type[EALError] | None = None
    """Its outcome, where that is settled before it runs."""


class MailboxMachine(RuleBasedStateMachine):
    """One actor, which is held and let go again and again."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = ManualClock()
        self.made: list[Turnstile] = []
        self.stack = ExitStack()
        self.robot = self.stack.enter_context(
            running_robot({"Gate": self.make}, clock=self.clock, mailbox=CAPACITY, timeout_s=1e6)
        )
        self.handle = self.robot["Gate"]
        self.numbers = itertools.count()
        self.is_held = False
        self.urgent: list[Waiting] = []
        self.normal: list[Waiting] = []
        self.refused: list[Waiting] = []
        self.expected: list[str] = []

    def make(self) -> Turnstile:
        self.made.append(Turnstile())
        return self.made[-1]

    @property
    def gate(self) -> Turnstile:
        (gate,) = self.made  # a restart would be a finding
        return gate

    @precondition(lambda self: not self.is_held)
    @rule()
    def hold(self) -> None:
        gate = self.gate
        gate.gate.clear()
        gate.entered.clear()
        self.held = self.handle.send_req("hold", timeout_s=1e9)
        assert gate.entered.wait(WAIT_S)
        self.is_held = True

    # While it is held.

    @precondition(lambda self: self.is_held)
    @rule(moves=st.booleans(), timeout_s=st.sampled_from([1.0, 3.0, 1e6]), ttl_s=st.sampled_from([0.5, 1e6]))
    def call(self, moves: bool, timeout_s: float, ttl_s: float) -> None:
        what = f"go{next(self.numbers)}" if moves else "value"
        method, arguments = ("send_cmd", (what, None)) if moves else ("get_value", ())
        begin_by_s = self.clock.now() + ttl_s
        future = self.handle.start_call(method, arguments, timeout_s, begin_by_s)
        waiting = Waiting(what, future, self.clock.now() + timeout_s, begin_by_s, moves)
        if len(self.normal) >= CAPACITY:
            waiting.error = BusyError
            self.refused.append(waiting)
        else:
            self.normal.append(waiting)

    @precondition(lambda self: self.is_held)
    @rule(timeout_s=st.sampled_from([1.0, 1e6]))
    def status(self, timeout_s: float) -> None:
        waiting = Waiting("status", self.handle.get_status(timeout_s=timeout_s), self.clock.now() + timeout_s, 1e9)
        if len(self.urgent) >= CAPACITY:
            waiting.error = BusyError
            self.refused.append(waiting)
        else:
            self.urgent.append(waiting)

    @precondition(lambda self: self.is_held)
    @rule(timeout_s=st.sampled_from([1.0, 1e6]))
    def halt(self, timeout_s: float) -> None:
        """A stop is never refused, is obeyed however late, and takes out the motions that wait."""
        future = self.handle.halt(timeout_s=timeout_s)
        self.urgent.append(Waiting("halt", future, self.clock.now() + timeout_s, 1e9, stops=True))
        for waiting in [waiting for waiting in self.normal if waiting.moves]:
            waiting.error = waiting.error or PreemptedError
            self.normal.remove(waiting)
            self.refused.append(waiting)

    @precondition(lambda self: self.is_held)
    @rule(duration_s=st.sampled_from([0.4, 1.0, 2.5]))
    def pass_time(self, duration_s: float) -> None:
        self.clock.advance(duration_s)

    @precondition(lambda self: self.is_held and self.normal)
    @rule(data=st.data())
    def give_up(self, data: st.DataObject) -> None:
        """An abandoned call keeps its place and does not run; the cancellation uses the urgent lane."""
        waiting = data.draw(st.sampled_from(self.normal))
        if waiting.future.cancel():
            waiting.error = CallCancelledError

    # Letting go.

    @precondition(lambda self: self.is_held)
    @rule()
    def let_go(self) -> None:
        self.gate.gate.set()
        self.is_held = False
        assert self.held.get(timeout=WAIT_S).value == DONE
        for waiting in [*self.urgent, *self.normal]:
            self.expect(waiting)
        for waiting in [*self.urgent, *self.normal, *self.refused]:
            self.check(waiting)
        self.urgent, self.normal, self.refused = [], [], []
        assert self.handle.get_value().get(timeout=WAIT_S).value == DONE  # what came before it has been run now
        self.expected.append("value")
        assert self.gate.ran == self.expected

    def expect(self, waiting: Waiting) -> None:
        now_s = self.clock.now()
        is_late = now_s >= waiting.deadline_s
        if waiting.stops:
            self.expected.append(waiting.what)
        elif waiting.error is None and is_late:
            waiting.error = DeadlineError
        elif waiting.error is None and now_s > waiting.begin_by_s:
            waiting.error = StaleCommandError
        elif waiting.error is None:
            self.expected.append(waiting.what)

    def check(self, waiting: Waiting) -> None:
        error = waiting.future.exception(timeout=WAIT_S)
        if waiting.stops and self.clock.now() >= waiting.deadline_s:
            assert error is None or isinstance(error, DeadlineError)  # a stop always runs
        elif waiting.error is None:
            assert error is None, error
        elif waiting.error in (BusyError, CallCancelledError):
            assert isinstance(error, waiting.error), (waiting, error)
        else:  # the deadline may be reported before a later result
            late = (DeadlineError,) if self.clock.now() >= waiting.deadline_s else ()
            assert isinstance(error, (waiting.error, *late)), (waiting, error)

    @invariant()
    def what_is_refused_is_known_at_once(self) -> None:
        assert all(waiting.future.done() for waiting in self.refused)

    @invariant()
    def the_mailbox_is_bounded(self) -> None:
        if self.is_held:
            waiting = self.handle.waiting
            assert waiting is not None
            assert waiting.count == len(self.urgent) + len(self.normal)
            assert len(self.normal) <= CAPACITY

    def teardown(self) -> None:
        for gate in self.made:
            gate.gate.set()
        self.stack.close()


MailboxMachine.TestCase.settings = settings(max_examples=40, stateful_step_count=25)
TestMailbox = MailboxMachine.TestCase
