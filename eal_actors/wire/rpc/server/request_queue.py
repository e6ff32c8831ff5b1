"""RequestQueue: calls of the robots themselves that wait for the host's thread, such as handshakes.

A handshake takes the thread longer than it takes a controller to send the next one. So the number of waiting calls is
bounded for each certificate, and certificates take turns: a flood by one of them delays another's call by one call.

Only one call at a time is in the host's mailbox. It comes behind the timers that are due, so that a flood does not
delay a dead-man's switch.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from collections.abc import Callable
from typing import Final

from eal_actors.kernel.errors import BusyError
from eal_actors.wire.format.keys import CallKey, certificate_id
from eal_actors.wire.format.messages import CallHeader
from eal_actors.wire.rpc.call_arguments import check_texts

MOST_WAITING: Final = 64
"""Limit of the waiting calls of one certificate to one robot."""
_MAX_TEXT: Final = 16_384


class RequestQueue:
    """Queue of calls, each an action, which `run` runs after the timers that are due. Thread: any."""

    def __init__(self, run: Callable[[Callable[[], None]], None]) -> None:
        self._run = run
        self._lock = threading.Lock()
        self._waiting: OrderedDict[tuple[str, str], deque[Callable[[], None]]] = OrderedDict()
        self._is_serving = False

    def add(self, call: CallKey, header: CallHeader, action: Callable[[], None]) -> None:
        """Queue a call. Does not block.

        Raises BusyError if too many calls of its certificate wait, and ProtocolError if its texts are too long.
        """
        check_texts(call.method, header.arguments, _MAX_TEXT)
        owner = call.robot, certificate_id(header.client)
        with self._lock:
            waiting = self._waiting.setdefault(owner, deque())
            if len(waiting) >= MOST_WAITING:
                raise BusyError(f"{MOST_WAITING} calls of this certificate wait for the robot")
            waiting.append(action)
            is_first, self._is_serving = not self._is_serving, True
        if is_first:
            self._run(self._serve_next)

    def _serve_next(self) -> None:
        with self._lock:
            owner, waiting = self._waiting.popitem(last=False)
            action = waiting.popleft()
            if waiting:
                self._waiting[owner] = waiting  # behind the others
            self._is_serving = has_more = bool(self._waiting)
        if has_more:
            self._run(self._serve_next)
        action()
