from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from eal_actors.kernel.errors import ArgumentError
from eal_actors.wire.rpc.server.leases import DeadManSwitch, LastCommander

CLIENTS = st.sampled_from(["ann", "bob"])
RESOURCES = st.sampled_from(["Wheels", "Arm", "Horn"])
DEAD_MAN_S = 2.0


class DeadManMachine(RuleBasedStateMachine):
    """Comparison with a model that keeps all heartbeats and searches for gaps."""

    def __init__(self) -> None:
        super().__init__()
        self.dead_man = DeadManSwitch(DEAD_MAN_S)
        self.now_s = 100.0
        self.signs: dict[str, list[float]] = {"ann": [], "bob": []}
        self.commanded: dict[str, tuple[str, float]] = {}

    def expected(self) -> list[str]:
        due = []
        for resource, (client, since_s) in self.commanded.items():
            times = [since_s, *(time_s for time_s in self.signs[client] if time_s > since_s), self.now_s]
            if any(later - earlier >= DEAD_MAN_S for earlier, later in itertools.pairwise(times)):
                due.append(resource)
        return sorted(due)

    @rule(quarters=st.integers(0, 9))
    def pass_time(self, quarters: int) -> None:
        self.now_s += quarters / 4

    @rule(client=CLIENTS, resource=RESOURCES)
    def command(self, client: str, resource: str) -> None:
        self.dead_man.commanded(client, resource, self.now_s)
        self.signs[client].append(self.now_s)
        self.commanded[resource] = (client, self.now_s)

    @rule(client=CLIENTS)
    def beat(self, client: str) -> None:
        self.dead_man.heard(client, self.now_s)
        self.signs[client].append(self.now_s)

    @rule(resource=RESOURCES)
    def halt(self, resource: str) -> None:
        self.dead_man.halted(resource)
        self.commanded.pop(resource, None)

    @rule(client=CLIENTS)
    def leave(self, client: str) -> None:
        mine = sorted(resource for resource, (owner, _) in self.commanded.items() if owner == client)
        assert self.dead_man.leave(client) == tuple(mine)
        for resource in mine:
            del self.commanded[resource]

    @rule(client=CLIENTS, resource=RESOURCES)
    def let_go(self, client: str, resource: str) -> None:
        is_mine = self.commanded.get(resource, ("",))[0] == client
        assert self.dead_man.leave(client, [resource]) == (resource,) * is_mine
        if is_mine:
            del self.commanded[resource]

    @rule()
    def ask(self) -> None:
        due = self.dead_man.due(self.now_s)
        assert [silence.resource for silence in due] == self.expected()
        for silence in due:
            assert silence.client == self.commanded.pop(silence.resource)[0]
        assert self.dead_man.due(self.now_s) == ()

    @invariant()
    def says_when_to_ask(self) -> None:
        due_s = self.dead_man.due_s
        assert (due_s is None) == (not self.commanded)
        assert (due_s is not None and due_s <= self.now_s) == bool(self.expected())


DeadManMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
TestDeadMan = DeadManMachine.TestCase


def test_a_silent_client_is_told_once_with_when_it_was_last_heard() -> None:
    dead_man = DeadManSwitch(0.5)
    dead_man.commanded("ann", "Wheels", 10.0)
    dead_man.heard("ann", 10.25)
    assert dead_man.due(10.5) == ()
    assert dead_man.due(10.75) == (LastCommander("Wheels", "ann", 10.25),)
    assert dead_man.due(99.0) == ()


def test_a_robot_that_was_frozen_halts_though_old_heartbeats_wait_for_it() -> None:
    dead_man = DeadManSwitch(2.0)
    dead_man.commanded("ann", "Wheels", 10.0)
    dead_man.heard("ann", 15.0)
    assert [silence.resource for silence in dead_man.due(15.0)] == ["Wheels"]


def test_who_commands_last_answers_for_the_resource() -> None:
    dead_man = DeadManSwitch(2.0)
    dead_man.commanded("ann", "Horn", 10.0)
    dead_man.commanded("bob", "Horn", 11.0)
    assert dead_man.due(12.5) == ()
    assert dead_man.due(13.0) == (LastCommander("Horn", "bob", 11.0),)


@pytest.mark.parametrize("dead_man_s", [0.0, 0.09, 60.1, -1.0, math.inf, math.nan])
def test_a_time_out_of_range_is_refused(dead_man_s: float) -> None:
    with pytest.raises(ArgumentError, match=r"dead_man_s must be 0\.1\.\.60 s, not"):
        DeadManSwitch(dead_man_s)


def test_the_ends_of_the_range_belong_to_it() -> None:
    assert [DeadManSwitch(dead_man_s).dead_man_s for dead_man_s in (0.1, 60.0)] == [0.1, 60.0]
