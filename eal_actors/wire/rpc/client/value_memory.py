"""ValueMemory: the memory that a controller shares with one robot for large values, if both are on one machine.

The current memory and the one before it stay open, since values in the latter may be on the way when it is replaced;
an older one is closed. Memory is offered only after a large value has come over the link, since most robots have none.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Final

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import UnavailableError
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer
from eal_actors.wire.rpc.client.controller import Controller
from eal_actors.wire.shared_memory import LEAST_BYTES, MOST_BYTES, OwnedMemory, SharedValue

_RENEW_S: Final = 5.0
"""Real seconds between two offers. A new memory replaces one that is too small, or whose slots hold values that were
lost on the way."""
_TIMEOUT_S: Final = 2.0


class ValueMemory:
    """Memory shared with one robot. Thread: the connection's, except `note` and `take`.

    A robot that cannot open it, since it is on another machine for example, refuses, and is not asked again until it
    has reconnected. `run_soon` and `request` are those of its Channel.
    """

    def __init__(
        self, run_soon: Callable[[Callable[[], None]], None], request: Callable[..., object], controller: Controller
    ) -> None:
        self._run_soon = run_soon
        self._request = request
        self._controller = controller
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
            self._run_soon(partial(self._offer, value_bytes))

    def take(self, value: SharedValue) -> Payload:
        """Return a value; see OwnedMemory.take. Thread: any.

        Raises ProtocolError if there is no such place, and UnavailableError if the value is no longer there.
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
        if not self._controller.shares_memory:
            return
        try:
            memory = OwnedMemory(value_bytes)
        except OSError as error:
            self._controller.give_up_sharing(error)
            return
        self._request(keys.MEMORY, tuple(memory.offer), _TIMEOUT_S, partial(self._finish_offer, memory))

    def _finish_offer(self, memory: OwnedMemory, answer: Answer | None) -> None:
        if answer != 1:
            memory.close()
            if answer is not None:
                self._next_offer_s = math.inf
            return
        try:
            memory.allocate()
        except OSError as error:
            memory.close()
            self._controller.give_up_sharing(error)
            return
        current, former = self._memories[:1], self._memories[1:]
        self._memories = (memory, *current)
        for old in former:
            old.close()
