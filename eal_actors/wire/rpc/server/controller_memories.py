"""ControllerMemories: the memory that controllers on the same machine share with one robot.

No value depends on it: where memory cannot be opened, or has no free slot, the value goes over the link. A controller
has one memory here at most, their number is limited, and one that its controller no longer has open is closed. So
controllers that are killed or offer memory again do not use up the robot's.
"""

from __future__ import annotations

import threading
from typing import Final

from eal_actors.device.data import Payload
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import error_text
from eal_actors.kernel.log import get_logger
from eal_actors.wire.shared_memory import LEAST_BYTES, MemoryOffer, PeerMemory, SharedValue

_MOST_MEMORIES: Final = 16
"""Limit of the controllers that share memory with one robot; others receive their values over their links."""
_CHECK_S: Final = 1.0


class ControllerMemories:
    """Memory of controllers by their client identifiers, if the fleet file enables it. Thread: any."""

    def __init__(self, robot: str, *, is_enabled: bool) -> None:
        self._is_enabled = is_enabled
        self._lock = threading.Lock()
        self._memories: dict[str, PeerMemory] = {}
        self._next_check_s = 0.0
        self._log = get_logger(robot=robot)

    def open(self, client: str, arguments: tuple[object, ...]) -> bool:
        """Open the memory that a controller offers, in place of its earlier one; ProtocolError if that is no offer.

        Returns whether it could be opened.
        """
        offer = MemoryOffer.parse(arguments)
        with self._lock:
            if not self._is_enabled or (len(self._memories) >= _MOST_MEMORIES and client not in self._memories):
                return False
            try:
                memory = PeerMemory(offer)
            except (OSError, ValueError) as error:  # another machine, another user, another process namespace
                self._log.debug("no memory is shared with a controller", client=client, reason=error_text(error))
                return False
            former = self._memories.get(client)
            self._memories[client] = memory
        if former is not None:
            former.close()
        return True

    def put(self, client: str, payload: Payload) -> SharedValue | None:
        """Hand a value to a controller; returns None if it must be sent over the link."""
        memory = self._memories.get(client)
        return None if memory is None or memoryview(payload).nbytes < LEAST_BYTES else memory.put(payload)

    def check(self) -> None:
        """Close memory that its controller has closed, once a second."""
        if self._memories and REAL_TIME.now() >= self._next_check_s:
            self._next_check_s = REAL_TIME.now() + _CHECK_S
            with self._lock:
                ended = [client for client, memory in self._memories.items() if not memory.is_offered]
                memories = [self._memories.pop(client) for client in ended]
            for memory in memories:
                memory.close()

    def close(self) -> None:
        """Close all memory."""
        with self._lock:
            self._is_enabled = False
            memories = list(self._memories.values())
            self._memories.clear()
        for memory in memories:
            memory.close()
