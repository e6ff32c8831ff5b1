from __future__ import annotations

import math
from dataclasses import dataclass

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from eal_actors.kernel.errors import StaleCommandError, UnavailableError
from eal_actors.wire.format.messages import CallHeader, CallId
from eal_actors.wire.rpc.freshness import MAX_DRIFT, CommandHistory, CommandRecord, Stamper

ERA = "era"

CLIENTS = ["a" * 16, "b" * 16, "c" * 16]
RESOURCES = st.sampled_from(["Wheels", "Arm"])
WAYS_S = st.sampled_from([0.0, 0.125, 0.5, 3.0])
OUTCOMES = 3


def stamped(stamper: Stamper, ttl_s: float, now_s: float) -> CallHeader:
    number, era, echo_s, held_s = stamper.stamp(now_s)
    return CallHeader(stamper.client, stamper.epoch, number, ttl_s, math.inf, era=era, echo_s=echo_s, held_s=held_s)


@dataclass(frozen=True)
class Sent:
    """A command on its way, and what nobody but the simulation knows: the robot's time when it was sent."""

    stamp: CallHeader
    resource: str
    sent_s: float


@dataclass
class Controller:
    stamper: Stamper
    rate: float
    ahead_s: float


class HistoryMachine(RuleBasedStateMachine):
    """A network that delays, repeats and reorders, clocks that differ and drift, and a memory of everything.

    The robot's clock is the true time. Letters that were sent stay in the network for ever, to arrive any time again.
    """

    clients = 3

    def __init__(self) -> None:
        super().__init__()
        self.now_s = 0.0
        self.run = 0
        self.letters: list[Sent] = []
        self.forget_everything()

    def forget_everything(self) -> None:
        self.history: CommandHistory[str] = CommandHistory(f"run {self.run}", outcomes=OUTCOMES, clients=self.clients)
        self.latest: dict[tuple[str, int, str], int] = {}
        self.epochs: dict[str, int] = {}
        self.running: set[CallId] = set()
        self.ended: dict[str, list[CallId]] = {client: [] for client in CLIENTS}

    @initialize(
        rates=st.tuples(*[st.sampled_from([1 - MAX_DRIFT, 1.0, 1 + MAX_DRIFT])] * 3),
        ahead_s=st.tuples(*[st.sampled_from([-1e5, 0.0, 77.7])] * 3),
    )
    def switch_on(self, rates: tuple[float, ...], ahead_s: tuple[float, ...]) -> None:
        self.controllers = [
            Controller(Stamper(client), rate, ahead)
            for client, rate, ahead in zip(CLIENTS, rates, ahead_s, strict=True)
        ]
        self.accepted: set[CallId] = set()

    def local_s(self, controller: Controller) -> float:
        return self.now_s * controller.rate + controller.ahead_s

    @rule(duration_s=st.sampled_from([0.125, 1.0, 20.0]))
    def pass_time(self, duration_s: float) -> None:
        self.now_s += duration_s

    @rule(index=st.integers(0, 2), way_s=WAYS_S)
    def answer(self, index: int, way_s: float) -> None:
        robot_s = self.now_s
        self.now_s += way_s
        controller = self.controllers[index]
        controller.stamper.heard(f"run {self.run}", robot_s, self.local_s(controller))

    @rule(index=st.integers(0, 2), resource=RESOURCES, ttl_s=st.sampled_from([0.25, 1.0]))
    def send(self, index: int, resource: str, ttl_s: float) -> None:
        controller = self.controllers[index]
        try:
            stamp = stamped(controller.stamper, ttl_s, self.local_s(controller))
        except UnavailableError:
            return
        self.letters.append(Sent(stamp, resource, self.now_s))

    @rule(index=st.integers(0, 2), resource=RESOURCES)
    def converse(self, index: int, resource: str) -> None:
        """Let an answer, a command and its arrival follow without a delay: the way it mostly goes."""
        self.answer(index, 0.0)
        self.send(index, resource, 1.0)
        self.deliver(self.letters[-1])

    @precondition(lambda self: self.letters)
    @rule(data=st.data())
    def arrive(self, data: st.DataObject) -> None:
        self.deliver(data.draw(st.sampled_from(self.letters[-8:])))

    @rule(index=st.integers(0, 2), hello_arrives=st.booleans())
    def reconnect(self, index: int, hello_arrives: bool) -> None:
        stamper = self.controllers[index].stamper
        stamper.reconnect()
        if hello_arrives:
            self.history.enter(stamper.client, stamper.epoch, self.now_s)
            self.epochs[stamper.client] = stamper.epoch

    @rule()
    def restart_robot(self) -> None:
        self.run += 1
        self.forget_everything()

    @precondition(lambda self: self.running)
    @rule(data=st.data())
    def finish(self, data: st.DataObject) -> None:
        call = data.draw(st.sampled_from(sorted(self.running)))
        self.history.finish(call, f"outcome of {call}")
        self.running.remove(call)
        self.ended[call.client].append(call)

    def deliver(self, sent: Sent) -> None:
        stamp, resource = sent.stamp, sent.resource
        client, epoch, sequence = stamp.call_id
        fits = (
            stamp.era == f"run {self.run}"
            and self.now_s - (stamp.echo_s + stamp.held_s * (1 - MAX_DRIFT)) <= stamp.ttl_s
            and epoch >= self.epochs.get(client, 0)
            and sequence > self.latest.get((client, epoch, resource), 0)
        )
        try:
            self.history.accept(stamp, resource, self.now_s)
        except StaleCommandError:
            assert not self.must_pass(fits)
            return
        assert fits
        assert stamp.call_id not in self.accepted
        assert self.now_s - sent.sent_s <= stamp.ttl_s + 1e-6
        self.accepted.add(stamp.call_id)
        self.running.add(stamp.call_id)
        self.epochs[client] = epoch
        self.latest[client, epoch, resource] = sequence

    def must_pass(self, fits: bool) -> bool:
        return fits

    @invariant()
    def remembers_running_and_the_last_ended(self) -> None:
        for call in self.running:
            assert self.history.recall(call) == CommandRecord(False)
        for calls in self.ended.values():
            for call in calls[-OUTCOMES:]:
                assert self.history.recall(call) == CommandRecord(True, f"outcome of {call}")
            for call in calls[:-OUTCOMES]:
                assert self.history.recall(call) is None


class ForgetfulMachine(HistoryMachine):
    """With more clients than the robot remembers: it may refuse more, and may never let more pass."""

    clients = 2

    def must_pass(self, fits: bool) -> bool:
        return False

    @invariant()
    def remembers_running_and_the_last_ended(self) -> None:
        assert len(self.history._clients) <= self.clients


HistoryMachine.TestCase.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)
ForgetfulMachine.TestCase.settings = HistoryMachine.TestCase.settings
TestHistory = HistoryMachine.TestCase
TestForgetful = ForgetfulMachine.TestCase


def stamp(
    client: str = "ann", sequence: int = 1, echo_s: float = 100.0, *, epoch: int = 0, ttl_s: float = 1.0
) -> CallHeader:
    return CallHeader(client, epoch, sequence, ttl_s, math.inf, era="run", echo_s=echo_s)


def test_what_waited_while_the_robot_was_frozen_is_refused() -> None:
    history: CommandHistory[int] = CommandHistory("run")
    history.accept(stamp(sequence=1), "Wheels", 100.5)
    with pytest.raises(StaleCommandError, match=r"sent up to 1\.500 s ago, and may be 1\.000 s old at most") as caught:
        history.accept(stamp(sequence=2), "Wheels", 101.5)
    assert str(caught.value).startswith("Wheels: command 2 (epoch 0) of controller ann was sent")


def test_the_last_instant_of_the_time_to_live_belongs_to_it() -> None:
    history: CommandHistory[int] = CommandHistory("run")
    history.accept(stamp(), "Wheels", 101.0)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"era": "yesterday"}, "run yesterday of the robot's server; this is run"),
        ({"held_s": 9.0}, "the robot's clock is slower"),
        ({"held_s": math.inf}, "the robot's clock is slower"),
        ({"ttl_s": math.nan}, "nan s old at most"),
        ({"held_s": math.nan}, "up to nan s ago"),
        ({"echo_s": -math.inf, "ttl_s": math.inf}, "forgotten whom it heard"),
    ],
)
def test_what_is_not_proven_fresh_is_refused(change: dict[str, float], why: str) -> None:
    history: CommandHistory[int] = CommandHistory("run")
    with pytest.raises(StaleCommandError, match=why):
        history.accept(stamp()._replace(**change), "Wheels", 100.0)  # type: ignore[arg-type]


def test_each_refusal_says_why() -> None:
    history: CommandHistory[int] = CommandHistory("run")
    history.accept(stamp(sequence=2), "Wheels", 100.0)
    with pytest.raises(StaleCommandError, match="was accepted before"):
        history.accept(stamp(sequence=2), "Wheels", 100.0)
    with pytest.raises(StaleCommandError, match="comes after number 2 was accepted"):
        history.accept(stamp(sequence=1), "Wheels", 100.0)
    history.accept(stamp(sequence=1), "Arm", 100.0)
    history.enter("ann", 1, 100.0)
    with pytest.raises(StaleCommandError, match="before the controller's reconnect number 1"):
        history.accept(stamp(sequence=3), "Wheels", 100.0)
    history.accept(stamp(sequence=1, epoch=1), "Wheels", 100.0)


def test_a_repeat_is_refused_when_its_outcome_is_forgotten() -> None:
    history: CommandHistory[str] = CommandHistory("run", outcomes=1)
    history.accept(stamp(sequence=1), "Wheels", 100.0)
    history.accept(stamp(sequence=2), "Arm", 100.0)
    for sequence in (1, 2):
        history.finish(CallId("ann", 0, sequence), "done")
    assert history.recall(CallId("ann", 0, 1)) is None
    assert history.recall(CallId("ann", 0, 2)) == CommandRecord(True, "done")
    with pytest.raises(StaleCommandError, match="comes after number 1"):
        history.accept(stamp(sequence=1), "Wheels", 100.0)


def test_the_certificate_with_most_outcomes_loses_its_oldest() -> None:
    history: CommandHistory[str] = CommandHistory("run", outcomes=4, outcomes_in_all=6)
    ann, bob, bobs_other = "a" * 16 + "1", "b" * 16 + "1", "b" * 16 + "2"
    calls = [*((ann, n) for n in (1, 2, 3)), *((client, n) for n in (1, 2) for client in (bob, bobs_other))]
    for client, sequence in calls:
        history.accept(stamp(client, sequence), "Wheels", 100.0)
        history.finish(CallId(client, 0, sequence), "done")
    forgotten = [call for call in calls if history.recall(CallId(call[0], 0, call[1])) is None]
    assert len(forgotten) == 1
    assert forgotten[0] in {(bob, 1), (bobs_other, 1)}


def test_a_client_that_is_forgotten_leaves_room_for_outcomes() -> None:
    history: CommandHistory[str] = CommandHistory("run", clients=1, outcomes_in_all=2)
    for n, client in enumerate(("ann", "bob", "eve")):
        for sequence in (1, 2):
            history.accept(stamp(client, sequence, echo_s=101.0 + n), "Wheels", 101.0 + n)
            history.finish(CallId(client, 0, sequence), "done")
        assert all(history.recall(CallId(client, 0, sequence)) for sequence in (1, 2))


def test_a_forgotten_client_cannot_repeat_but_can_go_on() -> None:
    history: CommandHistory[int] = CommandHistory("run", clients=1)
    history.accept(stamp("ann"), "Wheels", 100.25)
    history.accept(stamp("bob", echo_s=100.5), "Arm", 100.5)
    for echo_s in (100.0, 100.25):
        with pytest.raises(StaleCommandError, match="forgotten whom it heard"):
            history.accept(stamp("ann", echo_s=echo_s), "Wheels", 100.75)
    history.accept(stamp("ann", 2, echo_s=100.75), "Wheels", 100.75)


def test_a_forgotten_client_that_connects_anew_cannot_repeat() -> None:
    history: CommandHistory[int] = CommandHistory("run", clients=1)
    history.accept(stamp("ann"), "Wheels", 100.25)
    history.enter("bob", 0, 100.5)
    history.enter("ann", 0, 100.75)
    with pytest.raises(StaleCommandError, match="forgotten whom it heard"):
        history.accept(stamp("ann"), "Wheels", 100.75)


def test_the_client_heard_least_lately_is_forgotten() -> None:
    history: CommandHistory[str] = CommandHistory("run", clients=2)
    for client in ("ann", "bob"):
        history.accept(stamp(client), "Wheels", 100.0)
        history.finish(CallId(client, 0, 1), "done")
    history.enter("ann", 0, 100.25)
    history.enter("eve", 0, 100.5)
    assert history.recall(CallId("ann", 0, 1)) == CommandRecord(True, "done")
    assert history.recall(CallId("bob", 0, 1)) is None


def test_clients_that_wait_for_an_outcome_are_forgotten_last() -> None:
    history: CommandHistory[str] = CommandHistory("run", clients=2)
    history.accept(stamp("ann"), "Wheels", 100.0)
    history.accept(stamp("bob"), "Arm", 100.25)
    history.finish(CallId("bob", 0, 1), "done")
    history.accept(stamp("eve", echo_s=100.5), "Horn", 100.5)
    assert history.recall(CallId("ann", 0, 1)) == CommandRecord(False)
    assert history.recall(CallId("bob", 0, 1)) is None


def test_outcomes_outlast_a_reconnect() -> None:
    history: CommandHistory[str] = CommandHistory("run")
    history.accept(stamp(), "Wheels", 100.0)
    history.enter("ann", 1, 101.0)
    history.finish(CallId("ann", 0, 1), "arrived")
    assert history.recall(CallId("ann", 0, 1)) == CommandRecord(True, "arrived")


def test_the_stamp_tells_when_it_was_sent_at_the_earliest() -> None:
    stamper = Stamper("ann")
    stamper.heard("run", 500.0, 10.0)
    made = stamped(stamper, 2.0, 11.0)
    assert made.call_id == CallId("ann", 0, 1)
    assert CommandHistory[str]("run").accept(made, "Wheels", 502.0) == 501.0 - MAX_DRIFT


def test_the_echo_that_tells_most_is_kept_and_renewed() -> None:
    stamper = Stamper("ann")
    stamper.heard("run", 500.0, 10.0)
    stamper.heard("run", 500.5, 13.0)  # this one took 2.5 s longer
    assert stamped(stamper, 1.0, 13.0).echo_s == 500.0
    stamper.heard("run", 502.9999, 13.0)
    assert stamped(stamper, 1.0, 13.0).echo_s == 502.9999
    stamper.heard("run", 505.0, 23.0)
    assert stamped(stamper, 1.0, 23.0).echo_s == 505.0


def test_a_robot_that_runs_anew_is_believed_at_once() -> None:
    stamper = Stamper("ann")
    stamper.heard("run", 500.0, 10.0)
    stamper.heard("next run", 0.5, 11.0)
    made = stamped(stamper, 1.0, 11.0)
    assert (made.era, made.echo_s, made.held_s) == ("next run", 0.5, 0.0)


def test_without_any_answer_nothing_can_be_stamped() -> None:
    with pytest.raises(UnavailableError, match="has not answered yet"):
        Stamper("ann").stamp(0.0)


def test_the_certificate_with_most_clients_loses_one_of_its_own() -> None:
    history: CommandHistory[int] = CommandHistory(ERA, clients=3)
    quiet = CallHeader("a" * 32, 0, 1, 1.0, 1.0, era=ERA, echo_s=100.0)
    history.accept(quiet, "Arm", 100.0)
    history.finish(quiet.call_id, 1)
    for number in range(9):
        history.enter("b" * 16 + f"{number:016x}", 1, 101.0)
    assert history.recall(quiet.call_id) == CommandRecord(True, 1)


def test_an_echo_that_comes_after_the_clock_was_read_makes_no_command_from_the_future() -> None:
    stamper = Stamper("ann")
    stamper.heard("run", 500.0, 10.25)
    assert stamped(stamper, 1.0, 10.0).held_s == 0.0
