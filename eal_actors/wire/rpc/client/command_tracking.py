"""Commands that run on a remote robot: a list of all of them, and the follow-up of our own.

`CommandBoard` lists the commands of all controllers, from the handshake, the replies to pings and events.
`CommandTracker` follows our commands whose outcome has not arrived. An outcome may be lost with a link, so the tracker
asks the robot for it, at growing intervals.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.robot_view import RunningCommand
from eal_actors.device.resource import Progress
from eal_actors.kernel.errors import UnavailableError
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer, CallId
from eal_actors.wire.rpc.client.channel import Channel
from eal_actors.wire.rpc.client.handshake import running_from

_REATTACH_S: Final = 2.0
_CANCEL_S: Final = 1.0
_BACKOFF_S: Final = 1.0, 8.0
"""Shortest and longest real seconds between two requests for outcomes."""


class CommandBoard:
    """The commands that run on one robot, by its latest list; times are its real time. Thread: any.

    An outcome or a list replaces what the robot has sent before, whatever the order of arrival.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._running: dict[CallId, RunningCommand] = {}
        self._as_of_s = -math.inf

    def replace(self, rows: object, as_of_s: float) -> list[tuple[CallId, Progress]]:
        """Replace the list, unless it is older; return what has progressed. ProtocolError if the rows are malformed.

        The rows are those of running_from, in a message of a time of the robot.
        """
        running = running_from(rows)
        with self._lock:
            if as_of_s < self._as_of_s:
                return []
            before, self._running, self._as_of_s = self._running, running, as_of_s
        known = {call_id: command.progress for call_id, command in before.items()}
        progress = [(call_id, command.progress) for call_id, command in running.items()]
        return [(call_id, new) for call_id, new in progress if new is not None and new != known.get(call_id)]

    def end(self, call_id: CallId, at_s: float) -> None:
        """Remove a command that has ended by a time of the robot."""
        with self._lock:
            self._running.pop(call_id, None)
            self._as_of_s = max(self._as_of_s, at_s)

    def clear(self) -> None:
        """Forget the list: the robot is unreachable, or another process serves it."""
        with self._lock:
            self._running, self._as_of_s = {}, -math.inf

    def running(self, to_local: Callable[[float], float]) -> tuple[RunningCommand, ...]:
        """Return the running commands; `to_local` converts the robot's time to our fleet's."""
        with self._lock:
            commands = list(self._running.values())
        return tuple(
            replace(
                command,
                since_s=to_local(command.since_s),
                progress=command.progress and localized_progress(command.progress, to_local),
            )
            for command in commands
        )


def localized_progress(progress: Progress, to_local: Callable[[float], float]) -> Progress:
    """Return a progress with its time by our fleet's clock."""
    return replace(progress, time_s=to_local(progress.time_s))


class CommandTracker:
    """Our commands to one robot whose outcome has not arrived. Thread: any, except `tick` and `reattach`."""

    def __init__(self, channel: Channel) -> None:
        self.commands: Final[dict[CallId, Call[Any]]] = {}
        self._channel = channel
        self._ask_at_s = math.inf
        self._interval_s = _BACKOFF_S[0]
        self._suspects: set[CallId] = set()
        self._given_up: list[CallId] = []

    def restart_backoff(self) -> None:
        """Begin again with the shortest interval: the robot has accepted another command."""
        self._ask_at_s = math.inf

    def tick(self, now_s: float) -> None:
        """Ask for outcomes when that is due. Thread: the controller's."""
        if not self.commands:
            self._ask_at_s = math.inf
        elif self._ask_at_s == math.inf:
            self._interval_s = _BACKOFF_S[0]
            self._ask_at_s = now_s + self._interval_s
        elif now_s >= self._ask_at_s:
            self._interval_s = min(2 * self._interval_s, _BACKOFF_S[1])
            self._ask_at_s = now_s + self._interval_s
            if self._channel.is_ready:
                self._channel.run_soon(self.reattach)

    def give_up(self, reason: str) -> None:
        """Fail all commands, and cancel them when the robot is back. Thread: the connection's."""
        for call_id, call in list(self.commands.items()):
            if self.commands.pop(call_id, None) is not None:
                self._given_up.append(call_id)
                call.fail(UnavailableError(f"its outcome is unknown: {reason}"))

    def reattach(self) -> None:
        """Ask the robot for the outcomes. Thread: the connection's."""
        given_up, self._given_up = self._given_up, []
        for call_id in given_up:
            self._channel.request(keys.CANCEL, (call_id.epoch, call_id.sequence), _CANCEL_S)
        unfinished = [call_id for call_id, call in list(self.commands.items()) if not call.done()]
        if unfinished:
            numbers = tuple(number for call_id in unfinished for number in (call_id.epoch, call_id.sequence))
            self._channel.request(keys.REATTACH, numbers, _REATTACH_S, self._fail_unknown)

    def _fail_unknown(self, answer: Answer | None) -> None:
        """Fail commands that the robot does not know twice in succession: the first question may overtake them."""
        if not isinstance(answer, dict):
            return
        client = self._channel.controller.client
        unknown = {CallId(client, *numbers) for numbers in answer.get("unknown", ())}
        lost, self._suspects = self._suspects & unknown, unknown - self._suspects
        if self._suspects:
            self._ask_at_s = -math.inf
        for call_id in lost:
            call = self.commands.pop(call_id, None)
            if call is not None:
                call.fail(UnavailableError("the robot has no record of it: it was lost, or the robot was restarted"))

    def cancel(self, call: Call[Any]) -> None:
        """Cancel a command on the robot. Thread: the connection's."""
        for call_id in [call_id for call_id, command in list(self.commands.items()) if command is call]:
            self.commands.pop(call_id, None)
            self._channel.request(keys.CANCEL, (call_id.epoch, call_id.sequence), _CANCEL_S)
