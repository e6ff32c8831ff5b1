"""UnansweredCalls: a bounded mailbox for each resource of a remote robot, so that a frozen one makes no other busy."""

from __future__ import annotations

from typing import Any

from eal_actors.actors.call import Call
from eal_actors.kernel.errors import BusyError


class UnansweredCalls:
    """Calls to one robot that wait to be sent or answered, by resource.

    Args:
        capacity: limit of the calls to one resource.

    Thread: any; `add` one at a time.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._calls: dict[str, set[Call[Any]]] = {}

    def add(self, call: Call[Any], share: float = 1) -> None:
        """Add a call, which is refused at `share` times the capacity.

        Raises:
            BusyError: too many calls to its resource wait.
        """
        calls = self._calls.setdefault(call.cell.name, set())
        limit = share * self._capacity
        if len(calls) >= limit:
            raise BusyError(f"{limit:g} calls are pending already")
        calls.add(call)

    def discard(self, call: Call[Any]) -> None:
        """Remove a call; ignored if it is not there."""
        calls = self._calls.get(call.cell.name)
        if calls is not None:
            calls.discard(call)

    def clear(self) -> set[Call[Any]]:
        """Remove and return all calls."""
        calls, self._calls = self._calls, {}
        return set().union(*calls.values())
