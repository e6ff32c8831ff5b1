"""Control leases and the dead-man's switch: one commander for each actuator, and none that is silent.

Times are the robot's own, read when a message arrived; no clock of a controller matters.

Leases. The first command to an exclusive resource grants its lease. Heartbeats and further commands of the holder
renew all its leases. A lease ends when it is released, or when its holder was silent for the dead-man's time.
- At any time at most one client holds a resource, and only exclusive resources are ever held.
- A refused client changes nothing: neither the holder's lease nor its end.
- An ended lease stays ended: a late heartbeat does not revive it. Its former holder may claim it like anybody else.
Reading needs no lease. Halts and stops are for everybody, and neither take nor end a lease.

Dead-man's switch. The client that commanded a resource last is responsible for it. A heartbeat or any command proves
that a client is alive. For each silence of a client:
- A resource is due for a halt as soon as its client was silent for `dead_man_s`, and is returned once.
- Such a silence is never missed: a later heartbeat does not undo it, even if `due` was not called in between. So a
  robot that was itself frozen for longer than `dead_man_s` halts when it wakes, whatever old heartbeats arrive.
- A resource that another client has commanded since is not halted because of the earlier client.
Limit: a heartbeat counts from its arrival. After a stall of the link, or a freeze of the robot, that is shorter than
`dead_man_s`, a halt may come up to twice `dead_man_s` after the controller's last heartbeat was sent.

A lease and its dead-man's switch end in the same instant. Ask `DeadManSwitch.due` first, so that the former holder's
resource is halted before the next one's command.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from eal_actors.kernel.errors import ArgumentError, ResourceBusyError

_DEAD_MAN_RANGE_S: Final = 0.1, 60.0


def _checked_dead_man_s(dead_man_s: float) -> float:
    least_s, most_s = _DEAD_MAN_RANGE_S
    if not least_s <= dead_man_s <= most_s:
        raise ArgumentError(f"dead_man_s must be {least_s:g}..{most_s:g} s, not {dead_man_s!r}")
    return dead_man_s


@dataclass(slots=True)
class _Lease:
    holder: str
    heard_s: float


class Leases:
    """Leases of a robot's exclusive resources; at most one entry a resource. Thread: one at a time.

    All times are the robot's clock in seconds, and do not decrease from call to call. A holder may be silent for
    `dead_man_s` seconds, 0.1..60; ArgumentError if it is none of these. `name_of` returns the display name of a client.
    """

    def __init__(self, exclusive: Iterable[str], dead_man_s: float, name_of: Callable[[str], str] = str) -> None:
        self.exclusive: Final = frozenset(exclusive)
        self.dead_man_s: Final = _checked_dead_man_s(dead_man_s)
        self._name_of = name_of
        self._leases: dict[str, _Lease] = {}

    def claim(self, client: str, resource: str, now_s: float) -> None:
        """Renew a client's leases, and grant that of a resource; ResourceBusyError if another client holds it."""
        lease = self._leases.get(resource)
        is_own = lease is not None and lease.holder == client and len(self._leases) == 1  # the usual case
        if lease is not None and is_own and now_s < lease.heard_s + self.dead_man_s:
            lease.heard_s = now_s
            return
        self.renew(client, now_s)
        if resource not in self.exclusive:
            return
        lease = self._leases.get(resource)  # it has not ended, else `renew` had deleted it
        if lease is None:
            self._leases[resource] = _Lease(client, now_s)
        elif lease.holder != client:
            left_s = lease.heard_s + self.dead_man_s - now_s
            holder = self._name_of(lease.holder)
            raise ResourceBusyError(
                f"held by controller {holder}, until it releases it or is silent for {left_s:.2f} s more",
                resource=resource,
            )

    def renew(self, client: str, now_s: float) -> None:
        """Renew every lease of the client that has not ended, on its heartbeat."""
        dead_man_s, ended = self.dead_man_s, None
        for resource, lease in self._leases.items():
            if now_s >= lease.heard_s + dead_man_s:
                ended = [resource] if ended is None else [*ended, resource]
            elif lease.holder == client:
                lease.heard_s = now_s
        if ended is not None:
            for resource in ended:
                del self._leases[resource]

    def release(self, client: str, resource: str) -> None:
        """End a lease; ignored if the client does not hold it."""
        lease = self._leases.get(resource)
        if lease is not None and lease.holder == client:
            del self._leases[resource]

    def leave(self, client: str) -> None:
        """End every lease of a client that disconnects."""
        for resource in list(self._leases):
            self.release(client, resource)

    def holders(self, now_s: float) -> dict[str, str]:
        """Return the holding clients by resource, sorted by resource."""
        live = ((name, lease) for name, lease in self._leases.items() if now_s < lease.heard_s + self.dead_man_s)
        return {resource: lease.holder for resource, lease in sorted(live)}


class SilentController(NamedTuple):
    """Resource to halt, the client that commanded it last, and when the robot last heard of that."""

    resource: str
    client: str
    heard_s: float


class DeadManSwitch:
    """Watches the clients that command a robot's resources; at most one entry a resource. Thread: one at a time.

    All times are the robot's clock in seconds, and do not decrease from call to call. A client may be silent for
    `dead_man_s` seconds, 0.1..60; ArgumentError if it is none of these.
    """

    def __init__(self, dead_man_s: float) -> None:
        self.dead_man_s: Final = _checked_dead_man_s(dead_man_s)
        self._watched: dict[str, SilentController] = {}

    @property
    def due_s(self) -> float | None:
        """Robot's time of the next halt unless its client is heard before; None if nothing is watched."""
        return min(map(self._end_s, self._watched.values()), default=None)

    @property
    def clients(self) -> set[str]:
        """The clients that are responsible for a resource."""
        return {last.client for last in self._watched.values()}

    def commanded(self, client: str, resource: str, now_s: float) -> None:
        """Make a client responsible for a resource, in place of any other; this proves that it is alive."""
        if len(self._watched) > (resource in self._watched):  # others
            self.heard(client, now_s)
        # SilentController() takes several times as long, in every command.
        self._watched[resource] = tuple.__new__(SilentController, (resource, client, now_s))

    def heard(self, client: str, now_s: float) -> None:
        """Note that a client is alive. A silence that was too long stays due."""
        for resource, last in self._watched.items():
            if last.client == client and now_s < self._end_s(last):
                self._watched[resource] = SilentController(resource, client, now_s)

    def halted(self, resource: str) -> None:
        """Forget a resource that was halted by anybody."""
        self._watched.pop(resource, None)

    def leave(self, client: str, among: Container[str] | None = None) -> tuple[str, ...]:
        """Forget a client's resources, all if `among` is None; returns them sorted, for the caller to halt."""
        watched = {resource for resource, last in self._watched.items() if last.client == client}
        resources = sorted(resource for resource in watched if among is None or resource in among)
        for resource in resources:
            del self._watched[resource]
        return tuple(resources)

    def due(self, now_s: float) -> tuple[SilentController, ...]:
        """Return the resources to halt now, sorted, and forget them: each silence is returned once."""
        due = [last for last in self._watched.values() if now_s >= last.heard_s + self.dead_man_s]
        if not due:  # the usual case
            return ()
        for silent in due:
            del self._watched[silent.resource]
        return tuple(sorted(due, key=lambda silent: silent.resource))

    def _end_s(self, last: SilentController) -> float:
        return last.heard_s + self.dead_man_s
