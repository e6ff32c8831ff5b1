"""RemoteFeeds: requests streams of a robot and passes their frames to the readers.

Feeds with the same spec share one subscription and one lease, which is renewed three times within its length: a lost
request ends no stream. Frames are decoded by those who read them, so a frame that nobody reads costs little. One in
shared memory is taken out at once, since its slot would else stay in use.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final

from eal_actors.actors.call import ResourceCell
from eal_actors.actors.feeds import Item, Sink, StreamSpec
from eal_actors.device.data import EALData, Payload
from eal_actors.device.data.images import require_codec
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError
from eal_actors.wire.format import keys
from eal_actors.wire.format.frames import LEASE_S, canonical, decode_frame, rate_text, shared_place, stream_request
from eal_actors.wire.format.messages import Answer
from eal_actors.wire.rpc.client.channel import Channel

if TYPE_CHECKING:
    import zenoh

_RENEWALS: Final = 3
"""Renewals within the time of a lease."""


class RemoteFeeds:
    """Feeds of one robot's resources. Thread: the connection's, except `open`, `leave` and `read`."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._subscriptions: dict[tuple[str, StreamSpec], _Subscription] = {}
        self._is_renewing = False

    def open(self, cell: ResourceCell, spec: StreamSpec, sink: Sink) -> _RemoteFeed:
        """Open a feed; see OpenFeed. Raises UnsupportedError if OpenCV is needed and missing. Thread: any."""
        require_codec(spec.encoding)
        feed = _RemoteFeed(self, cell, canonical(spec), sink)
        self._channel.run_soon(lambda: self._join(feed))
        return feed

    def leave(self, feed: _RemoteFeed) -> None:
        """Close a feed. Thread: any; does not block."""
        self._channel.run_soon(lambda: self._leave(feed))

    def renew(self) -> None:
        """Request every stream again: a lease is to be renewed, or the robot has come back."""
        for subscription in list(self._subscriptions.values()):
            self._renew(subscription)

    def suspend(self) -> None:
        """End every subscription until the next renewal: the robot is lost, and its session may be another one then."""
        for subscription in self._subscriptions.values():
            subscription.end()

    def close(self) -> None:
        """End every subscription."""
        self.suspend()
        self._subscriptions.clear()

    def _join(self, feed: _RemoteFeed) -> None:
        if feed.is_closed:
            return
        name, spec = feed.cell.name, feed.spec
        subscription = self._subscriptions.get((name, spec))
        if subscription is None:
            fleet, robot = self._channel.controller.fleet, self._channel.name
            key = keys.stream_key(fleet, robot, name, spec.encoding, rate_text(spec))
            subscription = self._subscriptions[name, spec] = _Subscription(name, spec, key)
            self._renew(subscription)
        subscription.feeds = (*subscription.feeds, feed)
        if not self._is_renewing:
            self._is_renewing = True
            self._schedule_renewal()

    def _leave(self, feed: _RemoteFeed) -> None:
        subscription = self._subscriptions.get((feed.cell.name, feed.spec))
        if subscription is None:
            return
        subscription.feeds = tuple(other for other in subscription.feeds if other is not feed)
        if not subscription.feeds:
            del self._subscriptions[feed.cell.name, feed.spec]
            subscription.end()
            self._request(subscription, 0.0)

    def _schedule_renewal(self) -> None:
        self._channel.inbox.call_later(self._channel.clock.of_real(LEASE_S / _RENEWALS), self._renew_periodically)

    def _renew_periodically(self) -> None:
        self.renew()
        self._is_renewing = bool(self._subscriptions)
        if self._is_renewing:
            self._schedule_renewal()

    def _renew(self, subscription: _Subscription) -> None:
        if subscription.undeclare is None:
            on_sample = partial(self._receive, subscription)
            subscription.undeclare = self._channel.controller.subscribe(subscription.key, on_sample)
        self._request(subscription, LEASE_S)

    def _request(self, subscription: _Subscription, lease_s: float) -> None:
        arguments = stream_request(subscription.spec, lease_s)
        self._channel.request(keys.STREAM, arguments, LEASE_S, subscription.on_answer, subscription.resource)

    def _receive(self, subscription: _Subscription, _: str, sample: zenoh.Sample) -> None:
        """Pass an encoded frame to the feeds; its readers decode it. Thread: a reader's."""
        arrived_s, memory = REAL_TIME.now(), self._channel.memory
        attachment, payload = sample.attachment, sample.payload
        envelope = attachment.to_bytes() if attachment is not None else b""
        memory.note(len(payload))
        try:
            place = shared_place(envelope, self._channel.controller.client) if memory.is_shared else None
            item = partial(self._read, envelope, payload if place is None else memory.take(place), arrived_s)
        except EALError as error:
            subscription.offer(error)
        else:
            subscription.offer(item)

    def _read(self, envelope: bytes, payload: Payload | zenoh.ZBytes, arrived_s: float) -> EALData:
        """Return the value of a frame, its stamp in our fleet's time. Thread: that of the stream's reader.

        Raises EALError if the robot sent an error instead of a value, or the frame is malformed.
        """
        frame = decode_frame(envelope, payload if isinstance(payload, bytes | memoryview) else payload.to_bytes())
        if isinstance(frame.content, EALError):
            raise frame.content
        sent_s, _ = self._channel.clock_tracker.sent_s(frame.time, arrived_s)
        return frame.content.with_meta(stamp_s=self._channel.clock.from_real(sent_s - frame.age_s))


class _Subscription:
    """Subscription to one resource at one rate and in one encoding."""

    def __init__(self, resource: str, spec: StreamSpec, key: str) -> None:
        self.resource = resource
        self.spec = spec
        self.key = key
        self.feeds: tuple[_RemoteFeed, ...] = ()
        self.undeclare: Callable[[], None] | None = None

    def offer(self, item: Item) -> None:
        """Pass a frame or an error to the feeds. Thread: any."""
        for feed in self.feeds:
            feed.offer(item)

    def on_answer(self, answer: Answer | None) -> None:
        if isinstance(answer, EALError):
            self.offer(answer)

    def end(self) -> None:
        undeclare, self.undeclare = self.undeclare, None
        if undeclare is not None:
            undeclare()


class _RemoteFeed:
    """Feed of one stream; see Feed."""

    def __init__(self, feeds: RemoteFeeds, cell: ResourceCell, spec: StreamSpec, sink: Sink) -> None:
        self.cell = cell
        self.spec = spec
        self.is_closed = False
        self._feeds = feeds
        self._sink = sink

    def offer(self, item: Item) -> None:
        """Pass an item over the link, which may inject faults."""
        if self.cell.link.is_faulty:
            self.cell.carry(lambda: self._sink(item))
        else:
            self._sink(item)

    def close(self) -> None:
        if not self.is_closed:
            self.is_closed = True
            self._feeds.leave(self)
