"""Names: what controllers call themselves, for people. Nobody proves a name, and no right depends on one."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Final

_MOST: Final = 1024
_LONGEST: Final = 100


class Names:
    """The names of the controllers that were heard of last. Thread: any."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: OrderedDict[str, str] = OrderedDict()

    def note(self, client: str, name: str) -> None:
        """Take in a name; what a terminal could not show is left out of it."""
        shown = "".join(letter for letter in name[:_LONGEST] if letter.isprintable()).strip()
        if not shown or self._names.get(client) == shown:  # as each heartbeat but the first
            return
        with self._lock:
            self._names[client] = shown
            if len(self._names) > _MOST:
                self._names.popitem(last=False)

    def of(self, client: str) -> str:
        """Return a controller's name; its 16 digits if it gave none."""
        return self._names.get(client, client)
