"""StreamPublisher: a robot's side of streams. It publishes what somebody asks for, as long as somebody does."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from eal_actors.actors.actor import EALActor
from eal_actors.actors.feeds import Item, StreamSpec
from eal_actors.actors.handles import ResourceHandle, RobotHandle
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import BusyError, EALError, error_text
from eal_actors.kernel.log import get_logger
from eal_actors.net import keys
from eal_actors.net.frames import Frame, encode_frame, parse_request, rate_text
from eal_actors.net.images import require_codec
from eal_actors.net.wire import CallHeader, RobotTime

if TYPE_CHECKING:
    import zenoh

_MAX_STREAMS: Final = 64
"""Of one robot: so many resources, rates and encodings at a time."""

_LOOK_S: Final = 0.5
_JOIN_S: Final = 1.0


class StreamPublisher(EALActor):
    """Publishes the streams of one robot, each once however many read it.

    A stream is a resource, a rate and an encoding, and has a key of its own, so that a slow reader is sent no more than
    it asked for. Frames are encoded here, off the threads of the resources and of the commands; one that is not
    encoded when the next one comes is left out. What a link does not take at once is dropped.

    Args:
        fleet: the fleet's name.
        robot: the robot.
        session: an open session.
        era: the run of the robot's server.

    Thread: an actor, which starts with the first stream.
    """

    def __init__(self, fleet: str, robot: RobotHandle, session: zenoh.Session, era: str) -> None:
        super().__init__(f"{robot.name} streams", robot.clock)
        self._fleet = fleet
        self._robot = robot
        self._session = session
        self._era = era
        self._publications: dict[str, _Publication] = {}
        self._starting = threading.Lock()
        self._log = get_logger(robot=robot.name)

    # What the server passes on. Thread: any.

    def serve(self, handle: ResourceHandle, header: CallHeader) -> None:
        """Take in what asks for a stream.

        Raises:
            ProtocolError: it makes no sense.
            ArgumentError: such a rate or encoding does not exist, or does not fit the resource.
            UnsupportedError: the resource has no value; or OpenCV is needed and not installed.
            BusyError: the robot has too many streams.
        """
        spec, lease_s = parse_request(header.arguments)
        spec.check_resource(handle.info)
        key = keys.stream_key(self._fleet, self._robot.name, handle.name, spec.encoding, rate_text(spec))
        if lease_s:
            require_codec(spec.encoding)
            if len(self._publications) >= _MAX_STREAMS and key not in self._publications:
                raise BusyError(f"the robot publishes {_MAX_STREAMS} streams already")
        with self._starting:
            if self.thread is None:
                self.launch()
        self._soon(lambda: self._renew(key, handle, spec, header.client, lease_s))

    def leave(self, client: str) -> None:
        """A controller goes: it reads nothing more."""
        if self.thread is not None:
            self._soon(lambda: self._forget(client))

    def close(self) -> None:
        """End every stream. Thread: blocks the caller, for a bounded time."""
        if self.thread is not None:
            self._soon(self._stop)
            with self.clock.outside():
                self.thread.join(_JOIN_S)

    def _soon(self, action: Callable[[], None]) -> None:
        try:
            self.actor_inbox.call_soon(action)
        except EALError:
            self._log.debug("the streams have ended; something came too late")

    # In its own thread.

    def on_start(self) -> None:
        """Look after readers that are not heard of any more. Thread: the actor's own."""
        self._look()

    def on_stop(self) -> None:
        """Ask the resources for nothing more. Thread: the actor's own."""
        for publication in self._publications.values():
            publication.feed.close()
        self._publications.clear()

    def on_crash(self, error: BaseException) -> None:
        """See on_stop."""
        self._log.error("the streams have crashed", error=error_text(error))
        self.on_stop()

    def _renew(self, key: str, handle: ResourceHandle, spec: StreamSpec, client: str, lease_s: float) -> None:
        publication = self._publications.get(key)
        if publication is None:
            if not lease_s:
                return
            publication = self._publications[key] = _Publication(self, key, handle, spec)
        publication.leases[client] = REAL_TIME.now() + lease_s
        if not lease_s:
            self._forget(client, key)

    def _forget(self, client: str, key: str | None = None) -> None:
        for name, publication in self._publications.items():
            if key in (None, name):
                publication.leases.pop(client, None)
        self._end_unread()

    def _look(self) -> None:
        now_s = REAL_TIME.now()
        for publication in self._publications.values():
            publication.leases = {client: end_s for client, end_s in publication.leases.items() if end_s > now_s}
        self._end_unread()
        self.actor_inbox.call_later(self.clock.of_real(_LOOK_S), self._look)

    def _end_unread(self) -> None:
        for key in [key for key, publication in self._publications.items() if not publication.leases]:
            self._publications.pop(key).feed.close()

    def publish(self, publication: _Publication) -> None:
        """Send the newest value of a stream. Thread: any; does not block."""
        self._soon(lambda: self._publish(publication))

    def _publish(self, publication: _Publication) -> None:
        item = publication.take()
        if self._publications.get(publication.key) is not publication or callable(item):
            return
        encoding = publication.spec.encoding
        age_s = 0.0
        if isinstance(item, EALData) and item.stamp_s is not None:
            age_s = (self.clock.now() - item.stamp_s) / self.clock.of_real(1.0)
        try:
            envelope, payload = encode_frame(Frame(item, self._now(), age_s), encoding)
        except EALError as error:
            envelope, payload = encode_frame(Frame(error, self._now()), encoding)
        import zenoh

        try:
            self._session.put(
                publication.key,
                bytes(payload),
                attachment=envelope,
                priority=zenoh.Priority.DATA_LOW,  # below calls and answers
                congestion_control=zenoh.CongestionControl.DROP,
            )
        except Exception as error:  # noqa: BLE001  # zenoh's own: the session is being closed
            self._log.debug("a frame could not be sent", key=publication.key, reason=error_text(error))

    def _now(self) -> RobotTime:
        return RobotTime(self._era, REAL_TIME.now())


class _Publication:
    """One stream, and who reads it.

    Attributes:
        key: on which it is published.
        spec: its rate and encoding.
        leases: by reader, the real time until which it is published for it.
        feed: what brings its values.
    """

    def __init__(self, publisher: StreamPublisher, key: str, handle: ResourceHandle, spec: StreamSpec) -> None:
        self.key = key
        self.spec = spec
        self.leases: dict[str, float] = {}
        self._publisher = publisher
        self._lock = threading.Lock()
        self._item: Item | None = None
        self.feed = handle.open_feed(spec, self.offer)

    def offer(self, item: Item) -> None:
        """Receive an item from the feed; see `Sink`."""
        with self._lock:
            is_first, self._item = self._item is None, item
        if is_first:
            self._publisher.publish(self)

    def take(self) -> Item:
        """Return the newest value."""
        with self._lock:
            item, self._item = self._item, None
        assert item is not None  # noqa: S101  # each `publish` follows the first offer after a `take`
        return item
