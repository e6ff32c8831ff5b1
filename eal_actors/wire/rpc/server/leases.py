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

A lease and its dead-man's switch end in the same instant, since both are a table of the same kind. Ask
`DeadManSwitch.due` first, so that the former holder's resource is halted before the next one's command.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable
from typing import Final, NamedTuple

from eal_actors.kernel.errors import ArgumentError, ResourceBusyError

_DEAD_MAN_RANGE_S: Final = 0.1, 60.0


class LastCommander(NamedTuple):
    """Client that commanded a resource last, and when the robot last heard of it before a silence that was too long."""

    resource: str
    client: str
    heard_s: float


class _Commanders:
    """Table of the resources' last commanders; at most one entry a resource. Thread: one at a time.

    All times are the robot's clock in seconds, and do not decrease from call to call. A client may be silent for
    `dead_man_s` seconds, 0.1..60; ArgumentError if it is none of these.
    """

    def __init__(self, dead_man_s: float) -> None:
        least_s, most_s = _DEAD_MAN_RANGE_S
        if not least_s <= dead_man_s <= most_s:
            raise ArgumentError(f"dead_man_s must be {least_s:g}..{most_s:g} s, not {dead_man_s!r}")
        self.dead_man_s: Final = dead_man_s
        self._last: dict[str, LastCommander] = {}

    def commanded(self, client: str, resource: str, now_s: float) -> None:
        """Make a client responsible for a resource, in place of any other; this proves that it is alive."""
        if len(self._last) > (resource in self._last):  # others
            self.heard(client, now_s)
        # LastCommander() takes several times as long, in every command.
        self._last[resource] = tuple.__new__(LastCommander, (resource, client, now_s))

    def heard(self, client: str, now_s: float) -> None:
        """Note that a client is alive. A silence that was too long stays one."""
        for resource, last in self._last.items():
            if last.client == client and now_s < self._end_s(last):
                self._last[resource] = tuple.__new__(LastCommander, (resource, client, now_s))

    def leave(self, client: str, among: Container[str] | None = None) -> tuple[str, ...]:
        """Remove a client's resources, all if `among` is None; returns them sorted."""
        owned = {resource for resource, last in self._last.items() if last.client == client}
        resources = sorted(resource for resource in owned if among is None or resource in among)
        for resource in resources:
            del self._last[resource]
        return tuple(resources)

    def _end_s(self, last: LastCommander) -> float:
        return last.heard_s + self.dead_man_s


class Leases(_Commanders):
    """Leases of a robot's exclusive resources; `name_of` returns the display name of a client."""

    def __init__(self, exclusive: Iterable[str], dead_man_s: float, name_of: Callable[[str], str] = str) -> None:
        super().__init__(dead_man_s)
        self.exclusive: Final = frozenset(exclusive)
        self._name_of = name_of

    def claim(self, client: str, resource: str, now_s: float) -> None:
        """Renew a client's leases, and grant that of a resource; ResourceBusyError if another client holds it."""
        lease = self._last.get(resource)
        if resource not in self.exclusive:
            self.heard(client, now_s)
        elif lease is None or lease.client == client or now_s >= self._end_s(lease):
            self.commanded(client, resource, now_s)
        else:
            self.heard(client, now_s)
            left_s = self._end_s(lease) - now_s
            holder = self._name_of(lease.client)
            raise ResourceBusyError(
                f"held by controller {holder}, until it releases it or is silent for {left_s:.2f} s more",
                resource=resource,
            )

    def holders(self, now_s: float) -> dict[str, str]:
        """Return the holding clients by resource, sorted by resource."""
        return {name: lease.client for name, lease in sorted(self._last.items()) if now_s < self._end_s(lease)}


class DeadManSwitch(_Commanders):
    """Watches the clients that command a robot's resources."""

    @property
    def due_s(self) -> float | None:
        """Robot's time of the next halt unless its client is heard before; None if nothing is watched."""
        return min(map(self._end_s, self._last.values()), default=None)

    @property
    def clients(self) -> set[str]:
        """The clients that are responsible for a resource."""
        return {last.client for last in self._last.values()}

    def halted(self, resource: str) -> None:
        """Forget a resource that was halted by anybody."""
        self._last.pop(resource, None)

    def due(self, now_s: float) -> tuple[LastCommander, ...]:
        """Return the resources to halt now, sorted, and forget them: each silence is returned once."""
        due = [last for last in self._last.values() if now_s >= last.heard_s + self.dead_man_s]
        for silent in due:
            del self._last[silent.resource]
        return tuple(sorted(due))
