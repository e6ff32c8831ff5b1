"""LocalLinks: a controller's links to the robots' processes on its own machine; see local_link.

A robot has its link from the handshake on until its token changes, so that all its calls take one way and none
overtakes another. When a link ends alone, the calls on it are lost like those of a broken link of the engine: the ones
that change nothing are made again, and the robot is asked for the outcomes of the others.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from eal_actors.device.data import Payload
from eal_actors.managers.network_model import BEHIND_ROUTER, parse_endpoint
from eal_actors.wire.format import parts
from eal_actors.wire.local_link import LocalLink, dial

_MOST_KNOWN: Final = 256
"""Processes that are remembered, as each restart of a robot is another one."""


class LocalLinks:
    """Local links by process, and in `links` by robot. Thread: any; that of a link handles its replies."""

    def __init__(self, receive: Callable[[str, bytes, bytes], None], *, is_on: bool) -> None:
        self.links: Final[dict[str, LocalLink]] = {}
        self._receive = receive
        self._on_lost: dict[str, Callable[[], None]] = {}
        self._is_on = is_on
        self._lock = threading.Lock()
        self._processes: dict[str, LocalLink | None] = {}  # None for those that have refused

    def connect(self, robot: str, process: str, address: str, on_lost: Callable[[], None]) -> None:
        """Give a robot a link to its process, if that is on this machine. Thread: blocks the caller for a moment.

        `on_lost` is called when the link has ended, and the calls on it are lost. Thread: the link's.
        """
        if not self._is_on or not process or address == BEHIND_ROUTER:
            return
        with self._lock:
            if process not in self._processes:  # it is dialled once, also if it serves a thousand robots
                if len(self._processes) >= _MOST_KNOWN:
                    self._processes = {known: link for known, link in self._processes.items() if link is not None}
                self._processes[process] = dialled = dial(process, parse_endpoint(address).port)
                if dialled is not None:
                    dialled.start(self._receive, self._forget, "local replies")
            if (link := self._processes[process]) is not None:
                self._on_lost[robot] = on_lost
                self.links[robot] = link
            else:
                self.disconnect(robot)

    def disconnect(self, robot: str) -> None:
        """Take a robot's link away, which others may still use."""
        self.links.pop(robot, None)
        self._on_lost.pop(robot, None)

    def put(self, robot: str, key: str, envelope: bytes, payload: Payload, *, is_urgent: bool) -> bool | None:
        """Send a call, in parts if it is large; return None if it must go over the engine; see Controller.put."""
        link = self.links.get(robot)
        if link is None:
            return None
        if is_urgent:  # where the link has no room, the engine may
            return link.send(key, envelope, payload) or None
        if len(envelope) + len(payload) <= parts.PART_BYTES:
            return link.send_patiently(key, envelope, payload)
        return all(link.send_patiently(key, *part) for part in parts.split(envelope, payload))

    def _forget(self, link: LocalLink) -> None:
        with self._lock:
            self._processes = {process: other for process, other in self._processes.items() if other is not link}
            robots = [robot for robot, other in list(self.links.items()) if other is link]
            losses = [self._on_lost.get(robot) for robot in robots]
            for robot in robots:
                self.disconnect(robot)
        for lose in losses:
            if lose is not None:
                lose()

    def close(self) -> None:
        """End all links."""
        with self._lock:
            self._is_on = False
            links = list(self._processes.values())
        for link in links:
            if link is not None:
                link.close()
