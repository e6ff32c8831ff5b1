"""What a robot is doing: the commands under way, whoever gave them."""

from __future__ import annotations

import getpass
import os
import socket
from dataclasses import dataclass
from functools import cache
from typing import Any

from eal_actors.actors.call import Call
from eal_actors.device.resource import Progress


@dataclass(frozen=True, slots=True)
class Running:
    """A command under way.

    Attributes:
        resource: which carries it out.
        command: its text, or the method where that is not `send_cmd`.
        by: who gave it, as they call themselves.
        since_s: when it began, by the fleet's clock.
        progress: how far it has come; None if it does not tell.
    """

    resource: str
    command: str
    by: str
    since_s: float
    progress: Progress | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        told = self.progress
        return {
            "resource": self.resource,
            "command": self.command,
            "by": self.by,
            "since_s": self.since_s,
            "progress": None if told is None else {"fraction": told.fraction, "text": told.text, "time_s": told.time_s},
        }


def command_of(call: Call[Any]) -> str:
    """Return the text of a command, or the method of another call."""
    return str(call.arguments[0]) if call.method == "send_cmd" else call.method


def process_name(who: str | None = None) -> str:
    """Return what people call this process: `anna@lab-pc (pid 4711)`.

    Args:
        who: the name of its certificate; the user's if None.
    """
    return f"{who or _user()}@{socket.gethostname()} (pid {os.getpid()})"


@cache
def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a number without a name, as in some containers
        return str(os.getuid()) if hasattr(os, "getuid") else "somebody"
