"""What waits in a resource's mailbox: for those who watch a fleet."""

from __future__ import annotations

from dataclasses import dataclass

from eal_actors.actors.call import Call, ResourceCell
from eal_actors.actors.inbox import Inbox


@dataclass(frozen=True, slots=True)
class Waiting:
    """The calls that wait in a mailbox.

    Attributes:
        count: how many.
        oldest_s: seconds of the fleet's clock since the oldest of them was made; 0 if none waits.
    """

    count: int
    oldest_s: float


def waiting_in(cell: ResourceCell) -> Waiting | None:
    """Return what waits for a resource; None where its mailbox is in another process. Thread: any; does not block."""
    actor = cell.actor
    if actor is None:
        return Waiting(0, 0.0)
    inbox = actor.actor_inbox
    if not isinstance(inbox, Inbox):
        return None
    made_s = [
        call.deadline_s - call.timeout_s
        for call in (envelope.message for envelope in inbox.waiting())
        if isinstance(call, Call) and call.deadline_s is not None
    ]
    return Waiting(len(made_s), max(0.0, cell.clock.now() - min(made_s)) if made_s else 0.0)
