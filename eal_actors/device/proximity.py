"""What a simulation reports of its robots: the gaps around them, and their contacts."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple, TypeAlias

Observe: TypeAlias = Callable[[float, str, tuple[float, float], Mapping[str, float]], float]


@dataclass(frozen=True, slots=True)
class ProximityObserver:
    """Observes the gaps between the robots of a simulated world and everything around them.

    Attributes:
        reach_m: gaps wider than this are not reported.
        observe: receives the gaps around a robot at the end of a simulation tick: the time in seconds of the fleet's
            clock, the robot's name, x and y of its centre in the world's frame (m), and the gaps in metres by name,
            from its outline to the outline of everything within reach, below 0 where they overlap. It returns a gap in
            metres: the simulation calls again at the first tick whose end may find anything nearer. Thread: the one
            that steps the world; it must not block or call robots.
    """

    reach_m: float
    observe: Observe


_SAME_S: Final = 1.0
"""Time within which a repeated contact counts as the same one."""
_MAX_CONTACTS: Final = 1000


class Contact(NamedTuple):
    """A contact that begins.

    Attributes:
        time_s: seconds of the fleet's clock.
        robot: the robot's name.
        other: the other robot's name, or what the robot touches.
    """

    time_s: float
    robot: str
    other: str


class ContactLog:
    """The first contacts of the simulated robots of a fleet. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._contacts: list[Contact] = []
        self._last_s: dict[frozenset[str], float] = {}

    def note(self, contact: Contact) -> None:
        """Add a contact, unless the same two have touched a moment before, or the log is full."""
        pair = frozenset((contact.robot, contact.other))
        with self._lock:
            last_s, self._last_s[pair] = self._last_s.get(pair), contact.time_s
            if (last_s is None or contact.time_s > last_s + _SAME_S) and len(self._contacts) < _MAX_CONTACTS:
                self._contacts.append(contact)

    def since(self, time_s: float) -> list[Contact]:
        """Return the contacts from a time on."""
        with self._lock:
            return [contact for contact in self._contacts if contact.time_s >= time_s]
