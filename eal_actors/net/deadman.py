"""The dead-man's switch: what a robot must halt because the controller that commands it went silent.

Whoever commanded a resource last answers for it. A heartbeat, or any command, is a sign of life for all that its
client answers for. Times are the robot's own, read when the message came: no clock of a controller matters.

Guarantees, for one whole silence of a client:
- A resource is due for a halt as soon as its client was silent for `dead_man_s`, and is named once.
- A silence that long is never overlooked: a sign of life that comes after it does not undo it, even when `due` was not
  asked in between. So a robot that was itself frozen for longer than `dead_man_s` halts when it wakes, whatever old
  heartbeats wait in its sockets.
- A resource that another client has commanded since is not halted for the sake of the earlier one.

Limits: a sign of life counts from when it came, not from when it was sent. After a stall of the link, or a freeze of
the robot, that is shorter than `dead_man_s` and then delivers all at once, a halt may come up to twice `dead_man_s`
after the controller's last sign of life was sent.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass
from typing import Final

from eal_actors.kernel.errors import ArgumentError

MIN_DEAD_MAN_S: Final = 0.1
MAX_DEAD_MAN_S: Final = 60.0
DEFAULT_DEAD_MAN_S: Final = 2.0


def checked_dead_man_s(dead_man_s: float) -> float:
    """Return the time of a dead-man's switch.

    Raises:
        ArgumentError: it is outside 0.1..60 s.
    """
    if not MIN_DEAD_MAN_S <= dead_man_s <= MAX_DEAD_MAN_S:
        raise ArgumentError(f"dead_man_s must be {MIN_DEAD_MAN_S:g}..{MAX_DEAD_MAN_S:g} s, not {dead_man_s!r}")
    return dead_man_s


@dataclass(frozen=True, slots=True)
class Silence:
    """A resource whose client fell silent.

    Attributes:
        resource: what to halt.
        client: who commanded it last.
        heard_s: the robot's time of that client's last sign of life.
    """

    resource: str
    client: str
    heard_s: float


class DeadMan:
    """Watches the clients that command a robot's resources; it holds at most one entry a resource.

    All times are the robot's clock in seconds, and do not decrease from call to call.

    Args:
        dead_man_s: how long a client may be silent, 0.1..60 s.

    Raises:
        ArgumentError: `dead_man_s` is outside its range.

    Thread: one at a time.
    """

    def __init__(self, dead_man_s: float = DEFAULT_DEAD_MAN_S) -> None:
        self.dead_man_s: Final = checked_dead_man_s(dead_man_s)
        self._watched: dict[str, Silence] = {}

    @property
    def due_s(self) -> float | None:
        """The robot's time from which `due` names something unless a sign of life comes; None if nothing is watched."""
        return min(map(self._end_s, self._watched.values()), default=None)

    def commanded(self, client: str, resource: str, now_s: float) -> None:
        """Make a client answer for a resource, in place of whoever did; a sign of life of that client."""
        self.heard(client, now_s)
        self._watched[resource] = Silence(resource, client, now_s)

    def heard(self, client: str, now_s: float) -> None:
        """Take in a sign of life of a client. What it was silent about for too long stays due."""
        for resource, last in self._watched.items():
            if last.client == client and now_s < self._end_s(last):
                self._watched[resource] = Silence(resource, client, now_s)

    def halted(self, resource: str) -> None:
        """Forget a resource that was halted, by whomever: nothing moves there any more."""
        self._watched.pop(resource, None)

    def leave(self, client: str, among: Container[str] | None = None) -> tuple[str, ...]:
        """Forget a client that takes its leave, or lets go of some resources.

        Returns:
            What it answered for among these, or at all, sorted, for the caller to halt.
        """
        watched = {resource for resource, last in self._watched.items() if last.client == client}
        resources = sorted(resource for resource in watched if among is None or resource in among)
        for resource in resources:
            del self._watched[resource]
        return tuple(resources)

    def due(self, now_s: float) -> tuple[Silence, ...]:
        """Return what is to be halted now, sorted by resource, and forget it: each silence is told once."""
        if not any(now_s >= self._end_s(last) for last in self._watched.values()):  # as it mostly is
            return ()
        silences = sorted(
            (last for last in self._watched.values() if now_s >= self._end_s(last)), key=lambda last: last.resource
        )
        for silence in silences:
            del self._watched[silence.resource]
        return tuple(silences)

    def _end_s(self, last: Silence) -> float:
        return last.heard_s + self.dead_man_s
