"""Admission control: decides which commands a robot begins.

A command must be fresh and new (`CommandHistory`), its controller must hold the resource, and stay alive from then on
(`Commanders`). One lock guards both, since any thread may receive a message.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import OrderedDict
from collections.abc import Callable, Container, Iterable, Mapping
from typing import Final

from eal_actors.actors.call import MOTION_METHODS
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import DeadlineError, EALError, StaleCommandError, UnavailableError
from eal_actors.wire.format.keys import ANYBODY, ROBOT, certificate_id, client_id
from eal_actors.wire.format.messages import Answer, CallHeader, CallId
from eal_actors.wire.format.packing import MAX_CALL_BYTES
from eal_actors.wire.rpc.freshness import CommandHistory, CommandRecord
from eal_actors.wire.rpc.server.leases import Commanders, LastCommander

_CLAIMING: Final = MOTION_METHODS | {"set_config"}
"""Methods that require the lease of an exclusive resource."""

_RESERVE_S: Final = 0.01
"""Real seconds before its deadline in which a command no longer begins: between the last look at the clock and the
device, its thread may wait for the interpreter or a processor."""

_MAX_MESSAGE: Final = 1000
"""Kept characters of an error, since thousands of outcomes are kept."""
_LARGE_BYTES: Final = 4096
_MAX_KEPT_BYTES: Final = MAX_CALL_BYTES
"""Limit of the kept values of commands that are larger than _LARGE_BYTES; the newest is always kept."""
_MAX_NAMES: Final = 1024
_MAX_NAME: Final = 100
_NO_NAMES: Final[Mapping[str, str]] = {}


class ControllerNames:
    """Display names of the last controllers heard; no right depends on them, since only the certificate's is proven."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._names: dict[str, OrderedDict[str, str]] = {}  # by certificate, so that none pushes out another's

    def note(self, client: str, caller: str, name: str = "") -> str:
        """Store a controller's display name, without characters that a terminal cannot print; return the stored one.

        The caller is the name of its certificate, ANYBODY in a fleet without security; the name is how it calls itself.
        If that is empty, the stored name stays.
        """
        known_as = self._names.get(client[:16], _NO_NAMES).get(client)  # as certificate_id, in every command
        if known_as is not None and not name:  # every call but the first
            return known_as
        printable = "".join(letter for letter in name[:_MAX_NAME] if letter.isprintable()).strip()
        if caller != ANYBODY and printable.partition("@")[0] != caller:
            printable = f"{caller} ({printable})" if printable else caller
        if not printable or known_as == printable:  # every heartbeat but the first
            return known_as or client
        with self._lock:
            known = self._names.setdefault(certificate_id(client), OrderedDict())
            known[client] = printable
            if len(known) > _MAX_NAMES:
                known.popitem(last=False)
        return printable

    def of(self, client: str) -> str:
        """Return a controller's name; its client id if it has none."""
        return self._names.get(certificate_id(client), _NO_NAMES).get(client, client)


class Admission:
    """Admission control of one robot. Thread: any.

    `exclusive` are the resources that one controller at a time may command. `quiet_until_s` is the robot's time before
    which no controller's silence is too long. `overtaken` returns the error of a motion that was sent at a time before
    the robot's last emergency stop.
    """

    def __init__(
        self,
        era: str,
        exclusive: Iterable[str],
        dead_man_s: float,
        clock: Clock = REAL_TIME,
        overtaken: Callable[[float], EALError | None] = lambda _: None,
    ) -> None:
        self._clock = clock
        self._overtaken = overtaken
        self._guard = threading.Lock()
        self._history: CommandHistory[Answer] = CommandHistory(era)
        self._large: OrderedDict[CallId, int] = OrderedDict()
        self.names: Final = ControllerNames()
        self._commanders = Commanders(dead_man_s, exclusive, self.names.of)
        self.quiet_until_s = math.inf

    def check(self, header: CallHeader, method: str, resource: str) -> tuple[CallId, float, float, float]:
        """Admit a command; call `finish` when it has ended. Call `silences` first, unless it is quiet.

        Returns its identifier, the robot's real time, and the real seconds from then within which it must begin and
        until its deadline. Raises StaleCommandError if it is too old, or was received before, DeadlineError if its
        deadline has passed on the way, and ResourceBusyError if another controller holds the resource.
        """
        call_id = header.call_id
        with self._guard:
            now_s = self._clock.now()
            sent_s = self._history.accept(header, resource, now_s)
            left_s = sent_s + header.deadline_s - _RESERVE_S - now_s
            try:
                if left_s <= 0:
                    raise DeadlineError(f"{method} came {-left_s:.3f} s too late for its deadline; it was not executed")
                if method in _CLAIMING:
                    moves = method in MOTION_METHODS
                    if moves and (stopped := self._overtaken(sent_s)) is not None:
                        raise stopped
                    self._commanders.command(header.client, resource, now_s, moves=moves)
                    if moves and self.quiet_until_s > (due_s := now_s + self._commanders.dead_man_s):
                        self.quiet_until_s = due_s
                else:
                    self._commanders.heard(header.client, now_s)
            except EALError as error:
                self._history.finish(call_id, _kept(error))
                self._commanders.heard(header.client, now_s)  # a refused command proves life too
                raise
        return call_id, now_s, sent_s + header.ttl_s - now_s, left_s

    def note_stop(self, header: CallHeader, resource: str) -> None:
        """Refuse from now on commands that a stop has overtaken; the stop itself is obeyed at any age."""
        with self._guard:
            with contextlib.suppress(StaleCommandError):  # then the overtaken commands are stale too
                self._history.accept(header, resource, self._clock.now())
                self._history.finish(header.call_id, 1)
            self._commanders.halted(resource)

    def check_resume(self, header: CallHeader) -> None:
        """Admit the end of an emergency stop.

        Raises StaleCommandError if it is too old, was received before, or was sent before the last stop: who sent it
        did not know of that one.
        """
        with self._guard:
            sent_s = self._history.accept(header, ROBOT, self._clock.now())
            self._history.finish(header.call_id, 1)
        if self._overtaken(sent_s) is not None:
            raise StaleCommandError("an emergency stop came after this resume was sent: see why, then resume again")

    def finish(self, call: CallId, outcome: Answer) -> None:
        """Record the outcome of an admitted command."""
        if type(outcome) is int:  # the usual one
            with self._guard:
                self._history.finish(call, outcome)
            return
        if isinstance(outcome, EALError):
            outcome = _kept(outcome)
        with self._guard:
            self._history.finish(call, outcome)
            if isinstance(outcome, EALData) and outcome.length > _LARGE_BYTES:
                self._keep_large(call, outcome.length)

    def _keep_large(self, call: CallId, value_bytes: int) -> None:
        """Note a large kept value; give up the oldest ones that take too much memory with it."""
        self._large[call] = value_bytes
        while len(self._large) > 1 and sum(self._large.values()) > _MAX_KEPT_BYTES:
            oldest, _ = self._large.popitem(last=False)
            self._history.replace(oldest, UnavailableError("its value is no longer kept"))

    def recall(self, call: CallId) -> CommandRecord[Answer] | None:
        """Return the record of a command; see CommandHistory."""
        with self._guard:
            return self._history.recall(call)

    def enter(self, client: str, epoch: int) -> None:
        """Note a controller's handshake."""
        with self._guard:
            self._history.enter(client, epoch, self._clock.now())

    def heard(self, client: str) -> None:
        """Note a controller's heartbeat."""
        with self._guard:
            self._commanders.heard(client, self._clock.now())

    def leave(self, client: str, among: Container[str] | None = None) -> tuple[str, ...]:
        """End a controller's leases, all if `among` is None; returns the resources to halt."""
        with self._guard:
            return self._commanders.leave(client, among)

    def clients_of(self, caller: str) -> list[str]:
        """Return the controllers with the certificate of a name that hold or move anything."""
        with self._guard:
            clients = self._commanders.clients(self._clock.now())
        return sorted(client for client in clients if certificate_id(client) == certificate_id(client_id(caller, "")))

    def silences(self) -> tuple[LastCommander, ...]:
        """Return the resources to halt now because their controllers are silent; each silence is returned once."""
        with self._guard:
            due = self._commanders.due(self._clock.now())
            self.quiet_until_s = self._commanders.due_s
        return due

    def holders(self) -> dict[str, str]:
        """Return the clients that hold leases, by resource."""
        with self._guard:
            return self._commanders.holders(self._clock.now())


def _kept(error: EALError) -> EALError:
    """Return an error as it is kept: without its traceback, which refers to the arguments of the call."""
    kept = error.copy()
    kept.message = kept.message[:_MAX_MESSAGE]
    return kept
