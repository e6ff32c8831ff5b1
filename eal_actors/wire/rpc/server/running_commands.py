"""RunningCommands: the commands that a robot executes for controllers, and the replies that wait for their end.

Each command is answered once, although its end and the time after which it is accepted may coincide: the thread that
takes the address of the reply, under the lock, sends the reply. The outcome of an accepted command follows as an event.
The values of all commands that have not ended are limited in bytes, since mailboxes limit their number only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.robot_view import command_of
from eal_actors.device.resource import Progress
from eal_actors.kernel.errors import BusyError
from eal_actors.wire.format.messages import CallId
from eal_actors.wire.format.packing import MAX_CALL_BYTES
from eal_actors.wire.rpc.server.outbox import ReplyTo

_MOST_LISTED: Final = 256
"""Limit of the listed commands, since mailboxes hold more than a message should."""
_MAX_TEXT: Final = 200
_SMALL_BYTES: Final = 4096
"""Size up to which a value needs no room: the places of the mailboxes bound these."""
_MAX_VALUE_BYTES: Final = 2 * MAX_CALL_BYTES
"""Limit of the values of all commands of a robot that have not ended."""


@dataclass(eq=False, slots=True)
class ServedCommand:
    """A controller's command that has been passed to its resource and has not ended.

    Attributes:
        finish: called with it when it has ended.
        reply_to: address of the reply; None once the reply was sent.
        since_s: real time of its arrival.
        is_listed: whether an event has listed it, with `listed_progress`.
    """

    finish: Callable[[ServedCommand], None]
    call_id: CallId
    reply_to: ReplyTo | None
    call: Call[Any]
    since_s: float
    value_bytes: int = 0
    is_listed: bool = False
    listed_progress: Progress | None = None

    def __call__(self, *_: object) -> None:
        """Finish it, as the relay of its call; a function of its own for each command would be one more object."""
        self.finish(self)

    def to_row(self) -> list[Any]:
        """Return its row in a list of running commands; times are the robot's real time."""
        call, progress = self.call, self.call.progress()
        began_s = self.since_s if call.began_s is None else call.clock.to_real(call.began_s)
        fields: dict[str, Any] = {"resource": call.cell.name, "command": _truncate(command_of(call)), "by": call.caller}
        fields["since_s"] = began_s
        if progress is not None:
            fields["progress"] = [progress.fraction, _truncate(progress.text), call.clock.to_real(progress.time_s)]
        return [*self.call_id, fields]


class RunningCommands:
    """Running commands of one robot. Thread: any.

    Commands are added without the lock, so what goes through them goes through a copy.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: dict[CallId, ServedCommand] = {}

    def check_room(self, value_bytes: int) -> None:
        """Raise BusyError if the values of the commands that have not ended take too much memory for another one."""
        if value_bytes > _SMALL_BYTES:
            with self._lock:
                total = value_bytes + sum(command.value_bytes for command in list(self._running.values()))
            if total > _MAX_VALUE_BYTES:
                raise BusyError("the values of other commands fill the robot's memory; call again after they end")

    def add(self, command: ServedCommand) -> None:
        """Add a command that is about to be passed to its resource."""
        self._running[command.call_id] = command

    def end(self, command: ServedCommand) -> ReplyTo | None:
        """Remove a command that has ended; returns the address of its reply, None if that was sent before."""
        with self._lock:
            self._running.pop(command.call_id, None)
            reply_to, command.reply_to = command.reply_to, None
        return reply_to

    def take_long(self, since_s: float) -> list[tuple[ServedCommand, ReplyTo]]:
        """Return the commands that arrived by that time and whose reply is due, with their replies' addresses."""
        if not self._running:  # the usual case of a frequent call
            return []
        taken = []
        with self._lock:
            for command in list(self._running.values()):
                reply_to = command.reply_to
                if reply_to is not None and command.since_s <= since_s:
                    command.reply_to = None
                    taken.append((command, reply_to))
        return taken

    def listed(self) -> list[ServedCommand]:
        """Return the long commands that no longer wait for their start times."""
        long = [command for command in list(self._running.values()) if command.reply_to is None]
        begun = [it for it in long if it.call.start_s is None or it.call.began_s is not None]
        if len(begun) > _MOST_LISTED:
            begun.sort(key=lambda it: it.call.progress() is None)  # those that wait in a mailbox last
        return begun[:_MOST_LISTED]

    def cancel(self, call_id: CallId) -> None:
        """Cancel a command; ignored if it is not running."""
        with self._lock:
            command = self._running.get(call_id)
        if command is not None:
            command.call.cancel()


def _truncate(text: str) -> str:
    return text if len(text) <= _MAX_TEXT else f"{text[: _MAX_TEXT - 1]}…"
