"""Which commands a robot lets begin: history, leases and dead-man's switch together, against a model of the whole.

The parts have machines of their own in tests/unit/wire. Here controllers with clocks that differ speak through a
network that delays, repeats, reorders and swallows, to a robot that is frozen now and then; the model knows the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from eal_actors.kernel.errors import DeadlineError, ResourceBusyError, StaleCommandError, UnavailableError
from eal_actors.wire.format.messages import CallHeader, CallId
from eal_actors.wire.rpc.freshness import CommandRecord, Stamper
from eal_actors.wire.rpc.server.admission import Admission
from tests.manual_clock import ManualClock

CLIENTS = ("a" * 16, "b" * 16)
ACTUATORS = ["Arm", "Wheels"]
RESOURCES = st.sampled_from([*ACTUATORS, "Gauge"])
METHODS = st.sampled_from(["send_cmd", "set_value", "set_config"])
DEADLINES_S = st.sampled_from([0.125, 0.5, 5.0])
WAYS_S = st.sampled_from([0.0, 0.0, 0.25, 0.75])
WHO = st.integers(0, len(CLIENTS) - 1)
DEAD_MAN_S = 2.0
ERA = "run"


@dataclass(frozen=True)
class Letter:
    """A command on its way, and what nobody but the model knows: the true time when it was sent."""

    header: CallHeader
    method: str
    resource: str
    sent_s: float


@dataclass
class Answerable:
    """The controller that started a resource, and its last heartbeat without a gap."""

    client: str
    heard_s: float

    def is_overdue(self, now_s: float) -> bool:
        return now_s >= self.heard_s + DEAD_MAN_S


class AdmissionMachine(RuleBasedStateMachine):
    """The robot's clock is the true time; letters stay in the network for ever, to arrive any time again."""

    def __init__(self) -> None:
        super().__init__()
        self.clock = ManualClock(100.0)
        self.admission = Admission(ERA, ACTUATORS, DEAD_MAN_S, self.clock)
        self.letters: list[Letter] = []
        self.begun: dict[CallId, bool] = {}  # whether each has ended
        self.moving: dict[str, Answerable] = {}
        self.held: dict[str, Answerable] = {}

    @initialize(ahead_s=st.tuples(*[st.sampled_from([-1e5, 0.0, 77.7])] * len(CLIENTS)))
    def switch_on(self, ahead_s: tuple[float, ...]) -> None:
        self.ahead_s = ahead_s
        self.stampers = [Stamper(client) for client in CLIENTS]

    # Time and the link.

    @rule(quarters=st.integers(1, 9))
    def pass_time(self, quarters: int) -> None:
        self.clock.advance(quarters / 4)

    @rule(who=WHO, way_s=st.sampled_from([0.0, 0.125, 0.5]))
    def answer_arrives(self, who: int, way_s: float) -> None:
        robot_s = self.clock.now()
        self.clock.advance(way_s)
        self.stampers[who].heard(ERA, robot_s, self.clock.now() + self.ahead_s[who])

    @rule(who=WHO, resource=RESOURCES, method=METHODS, ttl_s=st.sampled_from([0.25, 1.0, 5.0]), deadline_s=DEADLINES_S)
    def send(self, who: int, resource: str, method: str, ttl_s: float, deadline_s: float) -> None:
        try:
            number, *stamp = self.stampers[who].stamp(self.clock.now() + self.ahead_s[who])
        except UnavailableError:
            return
        client, epoch = self.stampers[who].client, self.stampers[who].epoch
        header = CallHeader(client, epoch, number, ttl_s, deadline_s, None, ("go",), *stamp)  # type: ignore[arg-type]
        self.letters.append(Letter(header, method, resource, self.clock.now()))

    @rule(who=WHO, resource=RESOURCES, method=METHODS, way_s=WAYS_S, deadline_s=DEADLINES_S)
    def converse(self, who: int, resource: str, method: str, way_s: float, deadline_s: float) -> None:
        """Let an answer, a command and its arrival follow one another: the way it mostly goes."""
        self.answer_arrives(who, 0.0)
        self.send(who, resource, method, 1.0, deadline_s)
        self.clock.advance(way_s)
        self.deliver(self.letters[-1])

    @precondition(lambda self: self.letters)
    @rule(data=st.data())
    def arrive(self, data: st.DataObject) -> None:
        self.deliver(data.draw(st.sampled_from(self.letters[-6:])))

    # What the robot does.

    @rule()
    def look(self) -> None:
        """The host's look, which comes often, unless the robot is frozen."""
        now_s = self.clock.now()
        overdue = [name for name, last in sorted(self.moving.items()) if last.is_overdue(now_s)]
        silences = self.admission.silences()
        assert [(silence.resource, silence.client) for silence in silences] == [
            (name, self.moving.pop(name).client) for name in overdue
        ]

    def deliver(self, letter: Letter) -> None:
        """As RobotServer does: halt what is overdue first, then let the command pass or not."""
        self.look()
        now_s = self.clock.now()
        client, call = letter.header.client, letter.header.call_id
        holder = self.holder(letter.resource)
        try:
            _, _, begin_within_s, left_s = self.admission.check(letter.header, letter.method, letter.resource)
        except StaleCommandError:
            return  # whether that was right is the matter of HistoryMachine
        except DeadlineError:
            self.hear(client)
            self.begun[call] = True  # as with any refusal
            return
        except ResourceBusyError:
            self.refused(call, holder)
            return
        assert call not in self.begun, "a command passed twice"
        assert now_s + begin_within_s <= letter.sent_s + letter.header.ttl_s + 1e-6, "it may begin too late"
        assert begin_within_s >= -1e-6
        assert 0 < left_s <= letter.sent_s + letter.header.deadline_s - now_s, "it may move after its deadline"
        assert holder in (None, client), "two controllers command one actuator"
        self.begun[call] = False
        self.hear(client)
        if letter.resource in ACTUATORS:
            self.held[letter.resource] = Answerable(client, now_s)
        if letter.method != "set_config":
            before = self.moving.get(letter.resource)
            shared = letter.resource not in ACTUATORS
            assert before is None or before.client == client or shared, "it took over what another has left moving"
            self.moving[letter.resource] = Answerable(client, now_s)

    def refused(self, call: CallId, holder: str | None) -> None:
        assert holder not in (None, call.client)
        self.hear(call.client)
        self.begun[call] = True  # its refusal is its outcome, and it never passes again

    @precondition(lambda self: not all(self.begun.values()))
    @rule(data=st.data())
    def finish(self, data: st.DataObject) -> None:
        call = data.draw(st.sampled_from(sorted(call for call, has_ended in self.begun.items() if not has_ended)))
        self.admission.finish(call, 7)
        self.begun[call] = True
        assert self.admission.recall(call) == CommandRecord(True, 7)

    @rule(who=WHO)
    def beat(self, who: int) -> None:
        self.admission.heard(CLIENTS[who])
        self.hear(CLIENTS[who])

    @rule(who=WHO, resource=RESOURCES)
    def stop(self, who: int, resource: str) -> None:
        """Anybody's stop, however old: nothing moves there any more, and what it has overtaken is refused."""
        stale = CallHeader(CLIENTS[who], 0, 10_000_000, 0.0, 1.0, None, (), "another run", 0.0, 0.0)
        self.admission.note_stop(stale, resource)
        self.moving.pop(resource, None)

    @rule(who=WHO)
    def reconnect(self, who: int) -> None:
        stamper = self.stampers[who]
        stamper.reconnect()
        self.admission.names.note(stamper.client, "_", f"controller {who}")
        self.admission.enter(stamper.client, stamper.epoch)

    @rule(who=WHO)
    def leave(self, who: int) -> None:
        client = CLIENTS[who]
        mine = sorted(name for name, last in self.moving.items() if last.client == client)
        assert list(self.admission.leave(client)) == mine
        for name in mine:
            del self.moving[name]
        self.held = {name: last for name, last in self.held.items() if last.client != client}

    # The model.

    def hear(self, client: str) -> None:
        now_s = self.clock.now()
        for last in [*self.moving.values(), *self.held.values()]:
            if last.client == client and not last.is_overdue(now_s):
                last.heard_s = now_s

    def holder(self, resource: str) -> str | None:
        last = self.held.get(resource)
        return None if last is None or last.is_overdue(self.clock.now()) else last.client

    @invariant()
    def tells_who_holds_what(self) -> None:
        expected = {name: holder for name in ACTUATORS if (holder := self.holder(name)) is not None}
        assert self.admission._commanders.holders(self.clock.now()) == expected

    @invariant()
    def nothing_moves_unwatched(self) -> None:
        """Whatever moves has somebody who answers for it, and is due as soon as he is silent."""
        now_s, due_s = self.clock.now(), self.admission._commanders.due_s
        assert due_s == min((last.heard_s + DEAD_MAN_S for last in self.moving.values()), default=math.inf)
        assert all(last.heard_s <= now_s for last in self.moving.values())

    @invariant()
    def remembers_what_runs(self) -> None:
        for call, has_ended in self.begun.items():
            if not has_ended:
                assert self.admission.recall(call) == CommandRecord(False)


AdmissionMachine.TestCase.settings = settings(max_examples=100, stateful_step_count=40)
TestAdmission = AdmissionMachine.TestCase


def test_a_refused_command_may_not_pass_once_the_actuator_is_free() -> None:
    clock = ManualClock(100.0)
    admission = Admission(ERA, ACTUATORS, DEAD_MAN_S, clock)
    ann, bob = (CallHeader(client, 0, 1, 60.0, 60.0, None, ("go",), ERA, 100.0, 0.0) for client in CLIENTS)
    admission.check(ann, "send_cmd", "Arm")
    with pytest.raises(ResourceBusyError):
        admission.check(bob, "send_cmd", "Arm")
    clock.advance(DEAD_MAN_S)
    assert [silence.resource for silence in admission.silences()] == ["Arm"]
    with pytest.raises(StaleCommandError, match="was accepted before"):
        admission.check(bob, "send_cmd", "Arm")
