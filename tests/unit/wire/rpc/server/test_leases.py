from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from eal_actors.kernel.errors import ArgumentError, ResourceBusyError
from eal_actors.wire.rpc.server.leases import Commanders, LastCommander

CLIENTS = st.sampled_from(["ann", "bob", "eve"])
EXCLUSIVE = ("Arm", "Wheels")
RESOURCES = st.sampled_from([*EXCLUSIVE, "Horn"])
DEAD_MAN_S = 2.0


class CommandersMachine(RuleBasedStateMachine):
    """Against a model that ends leases at every step, and keeps all signs of life to search them for gaps."""

    def __init__(self) -> None:
        super().__init__()
        self.commanders = Commanders(DEAD_MAN_S, EXCLUSIVE)
        self.now_s = 50.0
        self.holder: dict[str, str] = {}
        self.silent_quarters: dict[str, int] = {}
        self.signs: dict[str, list[float]] = {"ann": [], "bob": [], "eve": []}
        self.moving: dict[str, tuple[str, float]] = {}

    def hear(self, client: str) -> None:
        self.signs[client].append(self.now_s)
        for resource, holder in self.holder.items():
            if holder == client:
                self.silent_quarters[resource] = 0

    def overdue(self) -> list[str]:
        due = []
        for resource, (client, since_s) in self.moving.items():
            times = [since_s, *(time_s for time_s in self.signs[client] if time_s > since_s), self.now_s]
            if any(later - earlier >= DEAD_MAN_S for earlier, later in itertools.pairwise(times)):
                due.append(resource)
        return sorted(due)

    @rule(quarters=st.integers(0, 9))
    def pass_time(self, quarters: int) -> None:
        self.now_s += quarters / 4
        for resource in list(self.holder):
            self.silent_quarters[resource] += quarters
            if self.silent_quarters[resource] >= DEAD_MAN_S * 4:
                del self.holder[resource]

    @rule(client=CLIENTS, resource=RESOURCES, moves=st.booleans())
    def command(self, client: str, resource: str, moves: bool) -> None:
        is_left_moving = not moves and resource in self.overdue()
        self.hear(client)
        if self.holder.get(resource, client) != client:
            with pytest.raises(ResourceBusyError, match=f"held by controller {self.holder[resource]},"):
                self.commanders.command(client, resource, self.now_s, moves=moves)
            return
        self.commanders.command(client, resource, self.now_s, moves=moves)
        if moves:
            self.moving[resource] = client, self.now_s
        if resource in EXCLUSIVE and not is_left_moving:
            self.holder[resource] = client
            self.silent_quarters[resource] = 0

    @rule(client=CLIENTS)
    def beat(self, client: str) -> None:
        self.commanders.heard(client, self.now_s)
        self.hear(client)

    @rule(resource=RESOURCES)
    def halt(self, resource: str) -> None:
        self.commanders.halted(resource)
        self.moving.pop(resource, None)

    @rule(client=CLIENTS, resource=RESOURCES)
    def release(self, client: str, resource: str) -> None:
        is_moving = self.moving.get(resource, ("",))[0] == client
        assert self.commanders.leave(client, [resource]) == (resource,) * is_moving
        if is_moving:
            del self.moving[resource]
        if self.holder.get(resource) == client:
            del self.holder[resource]

    @rule(client=CLIENTS)
    def release_nothing(self, client: str) -> None:
        assert self.commanders.leave(client, []) == ()

    @rule(client=CLIENTS)
    def leave(self, client: str) -> None:
        mine = sorted(resource for resource, (owner, _) in self.moving.items() if owner == client)
        assert self.commanders.leave(client) == tuple(mine)
        for resource in mine:
            del self.moving[resource]
        self.holder = {resource: holder for resource, holder in self.holder.items() if holder != client}

    @rule()
    def ask(self) -> None:
        overdue = self.overdue()
        due = self.commanders.due(self.now_s)
        assert [silence.resource for silence in due] == overdue
        for silence in due:
            assert silence.client == self.moving.pop(silence.resource)[0]
        assert self.commanders.due(self.now_s) == ()

    @invariant()
    def same_holders(self) -> None:
        assert self.commanders.holders(self.now_s) == dict(sorted(self.holder.items()))

    @invariant()
    def says_when_to_ask(self) -> None:
        due_s = self.commanders.due_s
        assert (due_s == math.inf) == (not self.moving)
        assert (due_s <= self.now_s) == bool(self.overdue())

    @invariant()
    def names_who_is_to_be_expelled(self) -> None:
        movers = {client for client, _ in self.moving.values()}
        assert self.commanders.clients(self.now_s) == movers.union(self.holder.values())


CommandersMachine.TestCase.settings = settings(max_examples=120, stateful_step_count=25, deadline=None)
TestCommanders = CommandersMachine.TestCase


def test_the_refusal_names_resource_holder_and_how_long() -> None:
    commanders = Commanders(2.0, ["Wheels"])
    commanders.command("ann", "Wheels", 10.0)
    with pytest.raises(ResourceBusyError) as caught:
        commanders.command("bob", "Wheels", 10.5)
    assert str(caught.value) == "Wheels: held by controller ann, until it releases it or is silent for 1.50 s more"
    assert caught.value.resource == "Wheels"


def test_a_refused_client_does_not_keep_the_lease_alive() -> None:
    commanders = Commanders(2.0, ["Wheels"])
    commanders.command("ann", "Wheels", 10.0)
    with pytest.raises(ResourceBusyError):
        commanders.command("bob", "Wheels", 11.75)
    commanders.command("bob", "Wheels", 12.0)
    assert commanders.holders(12.0) == {"Wheels": "bob"}


def test_a_late_heartbeat_does_not_revive_a_lease() -> None:
    commanders = Commanders(2.0, ["Wheels"])
    commanders.command("ann", "Wheels", 10.0)
    commanders.heard("ann", 12.0)
    assert commanders.holders(12.0) == {}
    commanders.command("ann", "Wheels", 12.0)
    assert commanders.holders(12.0) == {"Wheels": "ann"}


@pytest.mark.parametrize("client", ["ann", "bob"])
def test_a_command_that_moves_nothing_does_not_hide_a_silence(client: str) -> None:
    commanders = Commanders(2.0, ["Wheels"])
    commanders.command("ann", "Wheels", 10.0)
    commanders.command(client, "Wheels", 12.5, moves=False)
    assert commanders.due(12.5) == (LastCommander("Wheels", "ann", 10.0),)


@pytest.mark.parametrize("heard_s", [0.0, 0.1, 3.7, 1e6 / 3])
@pytest.mark.parametrize("dead_man_s", [0.1, 0.3, 2.0])
def test_a_lease_ends_in_the_instant_in_which_the_dead_man_halts(heard_s: float, dead_man_s: float) -> None:
    commanders = Commanders(dead_man_s, ["Wheels"])
    commanders.command("ann", "Wheels", heard_s)
    end_s = commanders.due_s
    assert commanders.holders(end_s) == {}
    assert len(commanders.due(end_s)) == 1


def test_a_silent_client_is_told_once_with_when_it_was_last_heard() -> None:
    commanders = Commanders(0.5)
    commanders.command("ann", "Wheels", 10.0)
    commanders.heard("ann", 10.25)
    assert commanders.due(10.5) == ()
    assert commanders.due(10.75) == (LastCommander("Wheels", "ann", 10.25),)
    assert commanders.due(99.0) == ()


def test_a_robot_that_was_frozen_halts_though_old_heartbeats_wait_for_it() -> None:
    commanders = Commanders(2.0)
    commanders.command("ann", "Wheels", 10.0)
    commanders.heard("ann", 15.0)
    assert [silence.resource for silence in commanders.due(15.0)] == ["Wheels"]


def test_who_commands_last_answers_for_the_resource() -> None:
    commanders = Commanders(2.0)
    commanders.command("ann", "Horn", 10.0)
    commanders.command("bob", "Horn", 11.0)
    assert commanders.due(12.5) == ()
    assert commanders.due(13.0) == (LastCommander("Horn", "bob", 11.0),)


@pytest.mark.parametrize("dead_man_s", [0.0, 0.09, 60.1, -1.0, math.inf, math.nan])
def test_a_time_out_of_range_is_refused(dead_man_s: float) -> None:
    with pytest.raises(ArgumentError, match=r"dead_man_s must be 0\.1\.\.60 s, not"):
        Commanders(dead_man_s)


def test_the_ends_of_the_range_belong_to_it() -> None:
    assert [Commanders(dead_man_s).dead_man_s for dead_man_s in (0.1, 60.0)] == [0.1, 60.0]
