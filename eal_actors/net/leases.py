"""Control leases: an actuator obeys one controller at a time.

The first command to an exclusive resource grants its lease; heartbeats and further commands of the holder keep all its
leases; a lease ends when it is released, or when its holder was silent for the dead-man's time. Times are the robot's
own, read when the message came.

Guarantees:
- At any time at most one client holds a resource, and only resources declared exclusive are ever held.
- A client that was refused changes nothing: neither the holder's lease nor its end.
- An ended lease stays ended: a late heartbeat does not revive it. Its former holder may claim again like anybody else.

What does not come here: reading, which needs no lease; and halt and stop, which anybody may do at any time, and which
neither take nor end a lease.

The dead-man's switch of the same time ends in the same instant. Ask it first (`DeadMan.due`), so that what the former
holder left moving is halted before the next one's command.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

from eal_actors.kernel.errors import ResourceBusyError
from eal_actors.net.deadman import DEFAULT_DEAD_MAN_S, checked_dead_man_s


@dataclass(slots=True)
class _Lease:
    holder: str
    heard_s: float


class Leases:
    """Who holds which of a robot's exclusive resources; at most one entry a resource.

    All times are the robot's clock in seconds, and do not decrease from call to call.

    Args:
        exclusive: names of the resources that one client at a time may command.
        dead_man_s: how long a holder may be silent, 0.1..60 s.
        name_of: makes of a client what people call it.

    Raises:
        ArgumentError: `dead_man_s` is outside its range.

    Thread: one at a time.
    """

    def __init__(
        self,
        exclusive: Iterable[str],
        dead_man_s: float = DEFAULT_DEAD_MAN_S,
        name_of: Callable[[str], str] = str,
    ) -> None:
        self.exclusive: Final = frozenset(exclusive)
        self.dead_man_s: Final = checked_dead_man_s(dead_man_s)
        self._name_of = name_of
        self._leases: dict[str, _Lease] = {}

    def claim(self, client: str, resource: str, now_s: float) -> None:
        """Let a client command a resource: grants the lease, or keeps it. A sign of life of that client.

        Raises:
            ResourceBusyError: another client, which is named, holds the resource.
        """
        self.renew(client, now_s)
        if resource not in self.exclusive:
            return
        lease = self._live(resource, now_s)
        if lease is None:
            self._leases[resource] = _Lease(client, now_s)
        elif lease.holder != client:
            left_s = lease.heard_s + self.dead_man_s - now_s
            holder = self._name_of(lease.holder)
            raise ResourceBusyError(
                f"held by controller {holder}, until it lets go or is silent for {left_s:.2f} s more",
                resource=resource,
            )

    def renew(self, client: str, now_s: float) -> None:
        """Take in a heartbeat: keeps every lease of the client that has not ended."""
        for resource in list(self._leases):
            lease = self._live(resource, now_s)
            if lease is not None and lease.holder == client:
                lease.heard_s = now_s

    def release(self, client: str, resource: str) -> None:
        """End a lease; does nothing if the client does not hold it."""
        lease = self._leases.get(resource)
        if lease is not None and lease.holder == client:
            del self._leases[resource]

    def leave(self, client: str) -> None:
        """End every lease of a client that takes its leave."""
        for resource in list(self._leases):
            self.release(client, resource)

    def holders(self, now_s: float) -> dict[str, str]:
        """Return who holds what: clients by the names of the resources, sorted by these."""
        live = {resource: self._live(resource, now_s) for resource in sorted(self._leases)}
        return {resource: lease.holder for resource, lease in live.items() if lease is not None}

    def _live(self, resource: str, now_s: float) -> _Lease | None:
        """Return a resource's lease; one that has ended is dropped."""
        lease = self._leases.get(resource)
        if lease is not None and now_s >= lease.heard_s + self.dead_man_s:
            del self._leases[resource]
            return None
        return lease
