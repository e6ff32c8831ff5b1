"""Control leases and the dead-man's switch: one commander for each actuator, and none that is silent.

Times are the robot's own, read when a message arrived; no clock of a controller matters.

Leases. The first command to an exclusive resource grants its lease. Heartbeats and further commands of the holder
renew all its leases. A lease ends when it is released, or when its holder was silent for the dead-man's time.
- At any time at most one client holds a resource, and only exclusive resources are ever held.
- A refused client changes nothing: neither the holder's lease nor its end.
- An ended lease stays ended: a late heartbeat does not revive it. Its former holder may claim it like anybody else.
Reading needs no lease. Halts and stops are for everybody, and neither take nor end a lease.

Dead-man's switch. The client that moved a resource last is responsible for it. A heartbeat or any command proves that a
client is alive. For each silence of a client:
- A resource is due for a halt as soon as its client was silent for `dead_man_s`, and is returned once.
- Such a silence is never missed: a later heartbeat does not undo it, even if `due` was not called in between. So a
  robot that was itself frozen for longer than `dead_man_s` halts when it wakes, whatever old heartbeats arrive.
- A resource that another client has moved since is not halted because of the earlier client.
Limit: a heartbeat counts from its arrival. After a stall of the link, or a freeze of the robot, that is shorter than
`dead_man_s`, a halt may come up to twice `dead_man_s` after the controller's last heartbeat was sent.

A lease and its dead-man's switch end in the same instant, since both are the same entry. Ask `due` first, so that the
former holder's resource is halted before the next one's command.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable
from typing import Final, NamedTuple

from eal_actors.kernel.errors import ArgumentError, ResourceBusyError

_DEAD_MAN_RANGE_S: Final = 0.1, 60.0


class LastCommander(NamedTuple):
    """Client that commanded a resource last, and when the robot last heard of it before a silence that was too long."""

    resource: str
    client: str
    heard_s: float


class Commanders:
    """Table of the resources' last commanders: who holds each, and who is responsible for what moves.

    All times are the robot's clock in seconds, and do not decrease from call to call. Thread: one at a time.

    Args:
        dead_man_s: seconds for which a client may be silent, 0.1..60; ArgumentError if it is none of these.
        exclusive: the resources that one client at a time may command.
        name_of: returns the display name of a client.
    """

    def __init__(self, dead_man_s: float, exclusive: Iterable[str] = (), name_of: Callable[[str], str] = str) -> None:
        least_s, most_s = _DEAD_MAN_RANGE_S
        if not least_s <= dead_man_s <= most_s:
            raise ArgumentError(f"dead_man_s must be {least_s:g}..{most_s:g} s, not {dead_man_s!r}")
        self.dead_man_s: Final = dead_man_s
        self._exclusive = frozenset(exclusive)
        self._name_of = name_of
        self._last: dict[str, LastCommander] = {}
        self._moving: set[str] = set()

    def command(self, client: str, resource: str, now_s: float, *, moves: bool = True) -> None:
        """Note a command, which proves that its client is alive, and grant the lease of an exclusive resource.

        From a command that moves it on, the client is responsible for the resource. Raises ResourceBusyError if another
        client holds it.
        """
        last = self._last.get(resource)
        if not moves or len(self._last) > (last is not None):  # else there is nothing more to renew
            self.heard(client, now_s)
        if last is not None and last.client != client and self._is_held(last, now_s):
            left_s, holder = self._end_s(last) - now_s, self._name_of(last.client)
            why = f"held by controller {holder}, until it releases it or is silent for {left_s:.2f} s more"
            raise ResourceBusyError(why, resource=resource)
        if moves:
            self._moving.add(resource)
        elif resource in self._moving or resource not in self._exclusive:  # what moves is halted first
            return
        # LastCommander() takes several times as long, in every command.
        self._last[resource] = tuple.__new__(LastCommander, (resource, client, now_s))

    def heard(self, client: str, now_s: float) -> None:
        """Note that a client is alive. A silence that was too long stays one."""
        for resource, last in self._last.items():
            if last.client == client and now_s < self._end_s(last):
                self._last[resource] = tuple.__new__(LastCommander, (resource, client, now_s))

    def leave(self, client: str, among: Container[str] | None = None) -> tuple[str, ...]:
        """End a client's leases, all if `among` is None; returns what it moves there, sorted, which is to be halted."""
        mine = {name for name, last in self._last.items() if last.client == client}
        owned = mine if among is None else {name for name in mine if name in among}
        for resource in owned:
            del self._last[resource]
        moving = owned & self._moving
        self._moving -= moving
        return tuple(sorted(moving))

    def holders(self, now_s: float) -> dict[str, str]:
        """Return the holding clients by resource, sorted by resource."""
        return {name: last.client for name, last in sorted(self._last.items()) if self._is_held(last, now_s)}

    def clients(self, now_s: float) -> set[str]:
        """Return the clients that hold or move anything."""
        return {self._last[resource].client for resource in self._moving}.union(self.holders(now_s).values())

    @property
    def due_s(self) -> float:
        """Robot's time of the next halt unless its client is heard before; infinite if nothing moves."""
        return min((self._end_s(self._last[resource]) for resource in self._moving), default=math.inf)

    def halted(self, resource: str) -> None:
        """Note that a resource was halted by anybody."""
        self._moving.discard(resource)

    def due(self, now_s: float) -> tuple[LastCommander, ...]:
        """Return the resources to halt now, sorted; each silence is returned once."""
        due = sorted(last for name in self._moving if now_s >= self._end_s(last := self._last[name]))
        self._moving.difference_update(last.resource for last in due)
        return tuple(due)

    def _is_held(self, last: LastCommander, now_s: float) -> bool:
        return last.resource in self._exclusive and now_s < self._end_s(last)

    def _end_s(self, last: LastCommander) -> float:
        return last.heard_s + self.dead_man_s
