from __future__ import annotations

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from eal_actors.kernel.errors import ArgumentError, ResourceBusyError
from eal_actors.wire.rpc.server.leases import DeadManSwitch, Leases

CLIENTS = st.sampled_from(["ann", "bob", "eve"])
EXCLUSIVE = ("Arm", "Wheels")
RESOURCES = st.sampled_from([*EXCLUSIVE, "Horn"])
DEAD_MAN_S = 2.0


class LeasesMachine(RuleBasedStateMachine):
    """Against a model that steps time in quarters of a second and ends leases at every step."""

    def __init__(self) -> None:
        super().__init__()
        self.leases = Leases(EXCLUSIVE, DEAD_MAN_S)
        self.now_s = 50.0
        self.holder: dict[str, str] = {}
        self.silent_quarters: dict[str, int] = {}

    def hear(self, client: str) -> None:
        for resource, holder in self.holder.items():
            if holder == client:
                self.silent_quarters[resource] = 0

    @rule(quarters=st.integers(0, 9))
    def pass_time(self, quarters: int) -> None:
        self.now_s += quarters / 4
        for resource in list(self.holder):
            self.silent_quarters[resource] += quarters
            if self.silent_quarters[resource] >= DEAD_MAN_S * 4:
                del self.holder[resource]

    @rule(client=CLIENTS, resource=RESOURCES)
    def command(self, client: str, resource: str) -> None:
        self.hear(client)
        if self.holder.get(resource, client) != client:
            with pytest.raises(ResourceBusyError, match=f"held by controller {self.holder[resource]},"):
                self.leases.claim(client, resource, self.now_s)
            return
        self.leases.claim(client, resource, self.now_s)
        if resource in EXCLUSIVE:
            self.holder[resource] = client
            self.silent_quarters[resource] = 0

    @rule(client=CLIENTS)
    def beat(self, client: str) -> None:
        self.leases.heard(client, self.now_s)
        self.hear(client)

    @rule(client=CLIENTS, resource=RESOURCES)
    def release(self, client: str, resource: str) -> None:
        self.leases.leave(client, [resource])
        if self.holder.get(resource) == client:
            del self.holder[resource]

    @rule(client=CLIENTS)
    def leave(self, client: str) -> None:
        self.leases.leave(client)
        self.holder = {resource: holder for resource, holder in self.holder.items() if holder != client}

    @invariant()
    def same_holders(self) -> None:
        assert self.leases.holders(self.now_s) == dict(sorted(self.holder.items()))


LeasesMachine.TestCase.settings = settings(max_examples=60, stateful_step_count=25, deadline=None)
TestLeases = LeasesMachine.TestCase


def test_the_refusal_names_resource_holder_and_how_long() -> None:
    leases = Leases(["Wheels"], 2.0)
    leases.claim("ann", "Wheels", 10.0)
    with pytest.raises(ResourceBusyError) as caught:
        leases.claim("bob", "Wheels", 10.5)
    assert str(caught.value) == "Wheels: held by controller ann, until it releases it or is silent for 1.50 s more"
    assert caught.value.resource == "Wheels"


def test_a_refused_client_does_not_keep_the_lease_alive() -> None:
    leases = Leases(["Wheels"], 2.0)
    leases.claim("ann", "Wheels", 10.0)
    with pytest.raises(ResourceBusyError):
        leases.claim("bob", "Wheels", 11.75)
    leases.claim("bob", "Wheels", 12.0)
    assert leases.holders(12.0) == {"Wheels": "bob"}


def test_a_late_heartbeat_does_not_revive_a_lease() -> None:
    leases = Leases(["Wheels"], 2.0)
    leases.claim("ann", "Wheels", 10.0)
    leases.heard("ann", 12.0)
    assert leases.holders(12.0) == {}
    leases.claim("ann", "Wheels", 12.0)
    assert leases.holders(12.0) == {"Wheels": "ann"}


@pytest.mark.parametrize("heard_s", [0.0, 0.1, 3.7, 1e6 / 3])
@pytest.mark.parametrize("dead_man_s", [0.1, 0.3, 2.0])
def test_a_lease_ends_in_the_instant_in_which_the_dead_man_halts(heard_s: float, dead_man_s: float) -> None:
    leases, dead_man = Leases(["Wheels"], dead_man_s), DeadManSwitch(dead_man_s)
    leases.claim("ann", "Wheels", heard_s)
    dead_man.commanded("ann", "Wheels", heard_s)
    end_s = dead_man.due_s
    assert end_s is not None
    assert leases.holders(end_s) == {}
    assert len(dead_man.due(end_s)) == 1


def test_a_time_out_of_range_is_refused() -> None:
    with pytest.raises(ArgumentError, match="dead_man_s"):
        Leases([], 61.0)
