"""Admission: which commands may begin: fresh ones, once, of whoever holds the resource and answers for it then.

It keeps a robot's receipts, leases and dead-man's switch together, for whichever thread brings a message.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable, Sequence
from typing import Final

from eal_actors.actors.call import MOTION_METHODS
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError, StaleCommandError
from eal_actors.net.deadman import DeadMan, Silence
from eal_actors.net.leases import Leases
from eal_actors.net.names import Names
from eal_actors.net.receipts import Receipt, Receipts, Stamp
from eal_actors.net.wire import Answer, CallHeader, CallId

_CLAIMING: Final = MOTION_METHODS | {"set_config"}
"""What takes an actuator for one controller."""


class Admission:
    """Lets the commands to one robot pass, or not.

    Args:
        era: the run of the robot's server.
        exclusive: names of the resources that one controller at a time may command.
        dead_man_s: how long a controller may be silent.
        clock: the robot's own; its seconds are real ones, but for tests.

    Attributes:
        names: what controllers call themselves.

    Thread: any.
    """

    def __init__(self, era: str, exclusive: Iterable[str], dead_man_s: float, clock: Clock = REAL_TIME) -> None:
        self._clock = clock
        self._guard = threading.Lock()
        self._receipts: Receipts[Answer] = Receipts(era)
        self.names: Final = Names()
        self._leases = Leases(exclusive, dead_man_s, self.names.of)
        self._dead_man = DeadMan(dead_man_s)

    def check(self, header: CallHeader, method: str, resource: str) -> float:
        """Let a command pass; it must be finished later. Ask `silences` first.

        Returns:
            Real seconds within which it must begin.

        Raises:
            StaleCommandError: it is too old, or came before.
            ResourceBusyError: another controller holds the resource.
        """
        stamp = _stamp_of(header)
        with self._guard:
            now_s = self._clock.now()
            self._receipts.accept(stamp, resource, now_s)
            self._dead_man.heard(header.client, now_s)  # a command that is refused is a sign of life too
            try:
                if method in _CLAIMING:
                    self._leases.claim(header.client, resource, now_s)
            except EALError as error:
                self._receipts.finish(stamp.call, error)
                raise
            if method in MOTION_METHODS:
                self._dead_man.commanded(header.client, resource, now_s)
        return stamp.begin_by_s - now_s

    def note_stop(self, header: CallHeader, resource: str) -> None:
        """Refuse from now on the commands that a stop has overtaken on its way; it is itself obeyed however old."""
        stamp = _stamp_of(header)
        with self._guard:
            with contextlib.suppress(StaleCommandError):  # then whatever it has overtaken is stale too
                self._receipts.accept(stamp, resource, self._clock.now())
                self._receipts.finish(stamp.call, 1)
            self._dead_man.halted(resource)

    def finish(self, call: CallId, outcome: Answer) -> None:
        """Remember how a command that has passed ended."""
        with self._guard:
            self._receipts.finish(call, outcome)

    def recall(self, call: CallId) -> Receipt[Answer] | None:
        """Return what is remembered of a command; see Receipts."""
        with self._guard:
            return self._receipts.recall(call)

    def enter(self, client: str, epoch: int, name: str) -> None:
        """Take note that a controller has connected anew, and of what it calls itself."""
        self.names.note(client, name)
        with self._guard:
            self._receipts.enter(client, epoch, self._clock.now())

    def hear(self, client: str) -> None:
        """Take in a controller's sign of life."""
        with self._guard:
            now_s = self._clock.now()
            self._dead_man.heard(client, now_s)
            self._leases.renew(client, now_s)

    def leave(self, client: str) -> tuple[str, ...]:
        """Let a controller go: what it held is free. Returns the resources that are to be halted."""
        with self._guard:
            self._leases.leave(client)
            return self._dead_man.leave(client)

    def release(self, client: str, resources: Sequence[str]) -> tuple[str, ...]:
        """Let a controller let go of resources: they are free. Returns those that are to be halted."""
        with self._guard:
            for resource in resources:
                self._leases.release(client, resource)
            return self._dead_man.leave(client, resources)

    def silences(self) -> tuple[Silence, ...]:
        """Return what is to be halted now, because its controller is silent; each is told once."""
        with self._guard:
            return self._dead_man.due(self._clock.now())

    def holders(self) -> dict[str, str]:
        """Return which controller holds which resource; `names` tells what they call themselves."""
        with self._guard:
            return self._leases.holders(self._clock.now())


def _stamp_of(header: CallHeader) -> Stamp:
    return Stamp(header.call_id, header.ttl_s, header.era, header.echo_s, header.held_s)
