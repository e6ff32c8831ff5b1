"""StreamPublisher: publishes a robot's streams while controllers request them.

A stream ends with its last lease, so a controller that is killed needs no goodbye. It keeps the newest value only and
drops frames in a full link: a slow reader misses frames and delays neither the robot nor the calls. The numbers of
streams and readers are limited for each certificate, so that none uses up the robot.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Final

from typing_extensions import override

from eal_actors.actors.actor import EALActor
from eal_actors.actors.feeds import Item, StreamSpec
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData, Payload
from eal_actors.device.data.images import require_codec
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.wire.format import keys
from eal_actors.wire.format.frames import StreamFrame, encode_frame, parse_stream_request, rate_text
from eal_actors.wire.format.messages import CallHeader, RobotTime
from eal_actors.wire.rpc.server.outbox import Outbox
from eal_actors.wire.shared_memory import SharedValue

_MAX_STREAMS: Final = 64
"""Limit of one certificate's streams of a robot; each is a resource, a rate and an encoding."""
_MAX_READERS: Final = 64
"""Limit of one certificate's readers of a stream."""

_TICK_S: Final = 0.5
_JOIN_S: Final = 1.0


class StreamPublisher(EALActor):
    """Publishes the streams of one robot, each once for any number of readers.

    Each stream has its own key, so a slow reader receives no more than it requested. Frames are encoded here, not in
    the threads of resources and commands. Thread: an actor, which starts with the first stream.
    """

    def __init__(
        self,
        fleet: str,
        robot: RobotHandle,
        outbox: Outbox,
        era: str,
        share: Callable[[str, Payload], SharedValue | None],
    ) -> None:
        super().__init__(f"{robot.name} streams", robot.clock)
        self._fleet = fleet
        self._robot = robot
        self._outbox = outbox
        self._era = era
        self._share = share
        self._streams: dict[str, _PublishedStream] = {}
        self._due: list[tuple[str, str]] = []
        """Streams and clients whose lease its thread will begin or renew: a burst of requests counts at once."""
        self._starting = threading.Lock()
        self._log = get_logger(robot=robot.name)

    def serve(self, handle: ResourceHandle, header: CallHeader) -> None:
        """Start, renew or end a controller's lease of a stream. Thread: any.

        Raises ProtocolError if the request is malformed, ArgumentError if the rate or the encoding does not exist or
        fit the resource, UnsupportedError if that has no value or OpenCV is missing, and BusyError if there are too
        many streams.
        """
        spec, lease_s = parse_stream_request(header.arguments)
        spec.check_resource(handle.info)
        key = keys.stream_key(self._fleet, self._robot.name, handle.name, spec.encoding, rate_text(spec))
        with self._starting:
            if lease_s:
                require_codec(spec.encoding)
                self._check_room(key, header.client)
                self._due.append((key, header.client))
            if self.thread is None:
                self.launch()
        self.run_soon(lambda: self._renew(key, handle, spec, header.client, lease_s))

    def _check_room(self, key: str, client: str) -> None:
        """Raise BusyError if the certificate of a client reads too many streams, or the stream too often."""
        owner = keys.certificate_id(client)
        readers = list(self._due)
        readers += [(name, reader) for name, stream in list(self._streams.items()) for reader in list(stream.leases)]
        ours = {(name, reader) for name, reader in readers if keys.certificate_id(reader) == owner}
        if (key, client) in ours:
            return
        if key not in (streams := {name for name, _ in ours}) and len(streams) >= _MAX_STREAMS:
            raise BusyError(f"the robot publishes {_MAX_STREAMS} streams for this certificate already")
        if sum(name == key for name, _ in ours) >= _MAX_READERS:
            raise BusyError(f"the stream has {_MAX_READERS} readers with this certificate already")

    def leave(self, client: str) -> None:
        """End all leases of a controller. Thread: any."""
        if self.thread is not None:
            self.run_soon(lambda: self._forget(client))

    def close(self) -> None:
        """End every stream. Thread: blocks the caller, for a bounded time."""
        if self.thread is not None:
            self.run_soon(self._stop)
            with self.clock.outside():
                self.thread.join(_JOIN_S)

    # In its own thread.

    @override
    def on_start(self) -> None:
        self._tick()

    @override
    def on_stop(self) -> None:
        for stream in self._streams.values():
            stream.feed.close()
        self._streams.clear()

    @override
    def on_crash(self, error: BaseException) -> None:
        self._log.error("the streams have crashed", error=error_text(error))
        self.on_stop()

    def _renew(self, key: str, handle: ResourceHandle, spec: StreamSpec, client: str, lease_s: float) -> None:
        if not lease_s:
            self._forget(client, key)
            return
        try:
            if (stream := self._streams.get(key)) is None:
                stream = self._streams[key] = _PublishedStream(self, key, handle, spec)
            stream.leases[client] = REAL_TIME.now() + lease_s
        finally:
            self._due.remove((key, client))

    def _forget(self, client: str, key: str | None = None) -> None:
        for name, stream in self._streams.items():
            if key in (None, name):
                stream.leases.pop(client, None)
        self._end_unread()

    def _tick(self) -> None:
        now_s = REAL_TIME.now()
        for stream in self._streams.values():
            stream.leases = {client: end_s for client, end_s in stream.leases.items() if end_s > now_s}
        self._end_unread()
        self.actor_inbox.call_later(self.clock.of_real(_TICK_S), self._tick)

    def _end_unread(self) -> None:
        for key in [key for key, stream in self._streams.items() if not stream.leases]:
            self._streams.pop(key).feed.close()

    def publish(self, stream: _PublishedStream) -> None:
        """Send the newest value of a stream. Thread: any; does not block."""
        self.run_soon(lambda: self._publish(stream))

    def _publish(self, stream: _PublishedStream) -> None:
        item = stream.take()
        if self._streams.get(stream.key) is not stream or callable(item):
            return
        encoding = stream.spec.encoding
        age_s = 0.0
        if isinstance(item, EALData) and item.stamp_s is not None:
            age_s = (self.clock.now() - item.stamp_s) / self.clock.of_real(1.0)
        try:
            frame = StreamFrame(item, self._now(), age_s)
            readers = stream.leases
            envelope, payload = encode_frame(
                frame, encoding, lambda it: [(client, self._share(client, it)) for client in readers]
            )
        except EALError as error:
            envelope, payload = encode_frame(StreamFrame(error, self._now()), encoding)
        import zenoh

        try:
            self._outbox.transport.session.put(
                stream.key,
                bytes(payload),
                attachment=envelope,
                priority=zenoh.Priority.DATA_LOW,  # below calls and replies
                congestion_control=zenoh.CongestionControl.DROP,
            )
        except Exception as error:  # noqa: BLE001  # zenoh's own: the session is being closed
            self._log.debug("a frame could not be sent", key=stream.key, reason=error_text(error))

    def _now(self) -> RobotTime:
        return RobotTime(self._era, REAL_TIME.now())


class _PublishedStream:
    """One stream and its readers. `leases` has, by client, the real time at which its lease ends."""

    def __init__(self, publisher: StreamPublisher, key: str, handle: ResourceHandle, spec: StreamSpec) -> None:
        self.key = key
        self.spec = spec
        self.leases: dict[str, float] = {}
        self._publisher = publisher
        self._lock = threading.Lock()
        self._item: Item | None = None
        self.feed = handle.open_feed(spec, self.offer)

    def offer(self, item: Item) -> None:
        with self._lock:
            is_first, self._item = self._item is None, item
        if is_first:
            self._publisher.publish(self)

    def take(self) -> Item:
        with self._lock:
            item, self._item = self._item, None
        assert item is not None  # noqa: S101  # each `publish` follows the first offer after a `take`
        return item
