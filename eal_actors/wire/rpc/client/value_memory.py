"""ValueMemory: the memory that a controller shares with one robot for large values, if both are on one machine."""

from __future__ import annotations

import math
from functools import partial
from typing import TYPE_CHECKING, Final

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import UnavailableError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer
from eal_actors.wire.shared_memory import LEAST_BYTES, MOST_BYTES, OwnedMemory, SharedValue

if TYPE_CHECKING:
    from eal_actors.wire.rpc.client.channel import Channel

_RENEW_S: Final = 5.0
"""Real seconds between two offers. A new memory replaces one that is too small, or whose slots hold values that were
lost on the way."""
_TIMEOUT_S: Final = 2.0


class ValueMemory:
    """Memory shared with one robot.

    It is offered when a large value has come over the link. A robot that cannot open it, since it is on another
    machine for example, refuses, and is not asked again until it has reconnected.

    Thread: the connection's, except `note` and `take`.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._memories: tuple[OwnedMemory, ...] = ()  # the current one and the former, whose values may be on the way
        self._next_offer_s = -math.inf

    @property
    def is_shared(self) -> bool:
        """Whether the robot may put values into it."""
        return bool(self._memories)

    def note(self, value_bytes: int) -> None:
        """Note that a value has come over the link. Thread: any; does not block."""
        if LEAST_BYTES <= value_bytes <= MOST_BYTES and REAL_TIME.now() >= self._next_offer_s:
            self._next_offer_s = REAL_TIME.now() + _RENEW_S
            self._channel.run_soon(partial(self._offer, value_bytes))

    def take(self, value: SharedValue) -> bytes:
        """Return a copy of a value and free its slot. Thread: any.

        Raises:
            ProtocolError: there is no such place.
            UnavailableError: the value is no longer there.
        """
        for memory in self._memories:
            if memory.offer.inode == value.inode:
                return memory.take(value)
        raise UnavailableError("a value is in shared memory that is closed; read it again")

    def reset(self) -> None:
        """Prepare for a robot that has come back, which may be another process now."""
        self._next_offer_s = -math.inf

    def close(self) -> None:
        """Close all memory."""
        memories, self._memories = self._memories, ()
        for memory in memories:
            memory.close()

    def _offer(self, value_bytes: int) -> None:
        if not self._channel.controller.shares_memory:
            return
        try:
            memory = OwnedMemory(value_bytes)
        except OSError as error:
            self._give_up(error)
            return
        accept = partial(self._finish_offer, memory)
        self._channel.request(keys.MEMORY, tuple(memory.offer), _TIMEOUT_S, accept, on_failure=memory.close)

    def _finish_offer(self, memory: OwnedMemory, answer: Answer) -> None:
        if answer != 1:
            memory.close()
            self._next_offer_s = math.inf
            return
        try:
            memory.allocate()
        except OSError as error:
            memory.close()
            self._give_up(error)
            return
        current, former = self._memories[:1], self._memories[1:]
        self._memories = (memory, *current)
        for old in former:
            old.close()

    def _give_up(self, error: OSError) -> None:
        """Log once that values come over the link."""
        if self._channel.controller.shares_memory:
            self._channel.controller.shares_memory = False
            message = "no shared memory; large values of robots on this machine come over their links"
            get_logger(fleet=self._channel.controller.fleet).warning(message, reason=error_text(error))
