"""RemoteFeeds: a controller's side of streams. It asks a robot to publish, and passes on what comes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Final

from eal_actors.actors.actor import EALActor
from eal_actors.actors.call import ResourceCell
from eal_actors.actors.feeds import Item, Sink, StreamSpec
from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError
from eal_actors.net import keys
from eal_actors.net.controller import Controller
from eal_actors.net.frames import LEASE_S, Frame, canonical, decode_frame, rate_text, stream_request
from eal_actors.net.images import require_codec
from eal_actors.net.pinging import Pinger
from eal_actors.net.timing import fleet_time_of
from eal_actors.net.wire import Answer

if TYPE_CHECKING:
    import zenoh

_RENEWALS: Final = 3
"""In the time of a lease."""


Ask = Callable[[str, tuple[str | int, ...], float, Callable[[Answer], None], str], None]
"""Asks a robot: method, arguments, time-out in real seconds, who takes the answer, resource."""


class RemoteFeeds:
    """The feeds of one robot's resources: those that want the same share one subscription.

    Args:
        robot: the robot's name.
        actor: the connection to the robot, in whose thread everything happens.
        controller: the fleet's end of the network.
        pinger: knows the offset of the robot's clock.
        ask: asks the robot.

    Thread: the connection's, but for `open` and `leave`.
    """

    def __init__(self, robot: str, actor: EALActor, controller: Controller, pinger: Pinger, ask: Ask) -> None:
        self._robot = robot
        self._actor = actor
        self._controller = controller
        self._pinger = pinger
        self._send = ask
        self._subscriptions: dict[tuple[str, StreamSpec], _Subscription] = {}
        self._is_renewing = False

    def open(self, cell: ResourceCell, spec: StreamSpec, sink: Sink) -> _RemoteFeed:
        """See OpenFeed.

        Raises:
            UnsupportedError: OpenCV is needed and not installed.
        """
        require_codec(spec.encoding)
        feed = _RemoteFeed(self, cell, canonical(spec), sink)
        self._soon(lambda: self._join(feed))
        return feed

    def leave(self, feed: _RemoteFeed) -> None:
        """Bring nothing more to a feed. Thread: any; does not block."""
        self._soon(lambda: self._leave(feed))

    def _soon(self, action: Callable[[], None]) -> None:
        with contextlib.suppress(EALError):  # the connection has ended, and with it every subscription
            self._actor.actor_inbox.call_soon(action)

    def renew(self) -> None:
        """Ask the robot for everything once more: it has come back."""
        for subscription in list(self._subscriptions.values()):
            self._renew(subscription)

    def close(self) -> None:
        """End every subscription."""
        for subscription in self._subscriptions.values():
            subscription.end()
        self._subscriptions.clear()

    def _join(self, feed: _RemoteFeed) -> None:
        if feed.is_closed:
            return
        name = feed.cell.name
        subscription = self._subscriptions.get((name, feed.spec))
        if subscription is None:
            key = keys.stream_key(self._controller.fleet, self._robot, name, feed.spec.encoding, rate_text(feed.spec))
            subscription = self._subscriptions[name, feed.spec] = _Subscription(name, feed.spec, key)
            self._renew(subscription)
        subscription.feeds = (*subscription.feeds, feed)
        if not self._is_renewing:
            self._is_renewing = True
            self._wait()

    def _leave(self, feed: _RemoteFeed) -> None:
        subscription = self._subscriptions.get((feed.cell.name, feed.spec))
        if subscription is None:
            return
        subscription.feeds = tuple(other for other in subscription.feeds if other is not feed)
        if not subscription.feeds:
            del self._subscriptions[feed.cell.name, feed.spec]
            subscription.end()
            self._ask(subscription, 0.0)

    def _wait(self) -> None:
        self._actor.actor_inbox.call_later(self._actor.clock.of_real(LEASE_S / _RENEWALS), self._renew_in_turn)

    def _renew_in_turn(self) -> None:
        self.renew()
        self._is_renewing = bool(self._subscriptions)
        if self._is_renewing:
            self._wait()

    def _renew(self, subscription: _Subscription) -> None:
        if subscription.undeclare is None:
            subscription.undeclare = self._controller.subscribe(subscription.key, subscription.take)
        self._ask(subscription, LEASE_S)

    def _ask(self, subscription: _Subscription, lease_s: float) -> None:
        arguments = stream_request(subscription.spec, lease_s)
        self._send(keys.STREAM, arguments, LEASE_S, subscription.hear, subscription.resource)

    def read(self, sample: zenoh.Sample, came_s: float) -> EALData:
        """Return the value of a frame, its stamp in our fleet's time. Thread: that of whoever reads the stream.

        Raises:
            EALError: what the robot told instead of a value; or the frame makes no sense.
        """
        attachment = sample.attachment
        frame = decode_frame(attachment.to_bytes() if attachment is not None else b"", sample.payload.to_bytes())
        if isinstance(frame.content, EALError):
            raise frame.content
        stamp_s = fleet_time_of(self._actor.clock, self._sent_s(frame, came_s) - frame.age_s)
        return frame.content.with_meta(stamp_s=stamp_s)

    def _sent_s(self, frame: Frame, came_s: float) -> float:
        """Return our real time at which a frame was sent, as well as it is known."""
        known = self._pinger.latest
        if known is None or known.era != frame.time.era:
            return came_s
        return min(came_s, frame.time.time_s - known.offset.offset_s)


class _Subscription:
    """What one resource publishes at one rate and in one encoding."""

    def __init__(self, resource: str, spec: StreamSpec, key: str) -> None:
        self.resource = resource
        self.spec = spec
        self.key = key
        self.feeds: tuple[_RemoteFeed, ...] = ()
        self.undeclare: Callable[[], None] | None = None

    def take(self, sample: zenoh.Sample) -> None:
        """Pass on a frame as it came: who reads it decodes it. Thread: zenoh's."""
        came_s = REAL_TIME.now()
        for feed in self.feeds:
            feed.bring(sample, came_s)

    def hear(self, answer: Answer) -> None:
        """Pass on why there will be nothing."""
        if isinstance(answer, EALError):
            for feed in self.feeds:
                feed.offer(answer)

    def end(self) -> None:
        """Take nothing more."""
        undeclare, self.undeclare = self.undeclare, None
        if undeclare is not None:
            undeclare()


class _RemoteFeed:
    """See Feed."""

    def __init__(self, feeds: RemoteFeeds, cell: ResourceCell, spec: StreamSpec, sink: Sink) -> None:
        self.cell = cell
        self.spec = spec
        self.is_closed = False
        self._feeds = feeds
        self._sink = sink

    def bring(self, sample: zenoh.Sample, came_s: float) -> None:
        """Take in a frame. Thread: zenoh's."""
        self.offer(partial(self._feeds.read, sample, came_s))

    def offer(self, item: Item) -> None:
        """Pass on something over the link, which may be impaired on purpose."""
        if self.cell.link.is_faulty:
            self.cell.carry(lambda: self._sink(item))
        else:
            self._sink(item)

    def close(self) -> None:
        """See Feed."""
        if not self.is_closed:
            self.is_closed = True
            self._feeds.leave(self)
