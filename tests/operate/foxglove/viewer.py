"""A viewer made with `websockets`, by the protocol's document: not Foxglove's own client.

Source: the protocol of Foxglove's WebSocket servers (ws-protocol, docs/spec.md).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from types import TracebackType
from typing import Any, NamedTuple

from websockets.sync.client import connect
from websockets.typing import Subprotocol

RECEIVE_S = 60.0
"""Real seconds that the server may take on a loaded machine."""


class Shown(NamedTuple):
    """A message: its topic, the time of its log entry in ns, and its content."""

    topic: str
    time_ns: int
    message: Any


class Viewer:
    """Reads the channels, subscribes, and yields messages."""

    def __init__(self, url: str) -> None:
        self._opening = connect(
            url,
            subprotocols=[Subprotocol("foxglove.sdk.v1")],
            max_size=None,
            open_timeout=RECEIVE_S,
            ping_interval=None,  # while nobody receives, it reads no answer, and would take the server for dead
        )
        self._socket: Any = None
        self.info: dict[str, Any] = {}
        self.channels: dict[str, dict[str, Any]] = {}
        self.parameters: dict[str, Any] = {}
        self._topics: dict[int, str] = {}

    def __enter__(self) -> Viewer:
        self._socket = self._opening.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._opening.__exit__(kind, error, traceback)

    def send(self, **fields: Any) -> None:
        self._socket.send(json.dumps(fields))

    def subscribe(self, *topics: str) -> None:
        """Subscribe to topics once they are advertised."""
        while not set(topics) <= set(self.channels):
            self.receive()
        pairs = [(self.channels[topic]["id"], topic) for topic in topics]
        self._topics.update(pairs)
        self.send(op="subscribe", subscriptions=[{"id": number, "channelId": number} for number, _ in pairs])

    def publish(self, channel: int, content: Any) -> None:
        self.publish_bytes(channel, json.dumps(content).encode())

    def publish_bytes(self, channel: int, content: bytes) -> None:
        self.send_raw(struct.pack("<BI", 1, channel) + content)

    def send_raw(self, frame: str | bytes) -> None:
        self._socket.send(frame)

    def receive(self) -> Shown | None:
        """Receive one frame; returns the message in it, if it has one."""
        frame = self._socket.recv(timeout=RECEIVE_S)
        if isinstance(frame, bytes):
            if frame[0] != 1:
                return None
            subscription, time_ns = struct.unpack_from("<IQ", frame, 1)
            return Shown(self._topics[subscription], time_ns, json.loads(frame[13:]))
        fields = json.loads(frame)
        match fields["op"]:
            case "serverInfo":
                self.info = fields
            case "advertise":
                self.channels.update((channel["topic"], channel) for channel in fields["channels"])
            case "parameterValues":
                self.parameters.update((one["name"], one.get("value")) for one in fields["parameters"])
        return None

    def messages(self) -> Iterator[Shown]:
        while True:
            if (shown := self.receive()) is not None:
                yield shown
