"""Transport: sends and receives messages over one zenoh session; used by both ends.

Why channels: a callback in zenoh's own threads takes the interpreter's lock from a foreign thread, which costs more
than a hop between two Python threads. So each subscription has a channel and a Python thread that reads it. A full
channel holds up zenoh's thread and with it the sender, as a full socket would; handlers do not block.

Why keys are declared at both ends: a message of a declared publisher carries a number in place of the key, and both
ends know its route. A receiver that has not declared the key itself compares it with the key expressions of all its
subscriptions, 5 µs and more for each message. Together that is a sixth of a call. A key is declared once it has been
used a few times, since declaring thousands of keys that are used once would cost more than it saves. Our own session is
no destination, so the engine does not look for subscriptions there.

Thread: any.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from eal_actors.device.data import Payload
from eal_actors.kernel.errors import error_text
from eal_actors.kernel.log import get_logger
from eal_actors.wire import engine_exit

if TYPE_CHECKING:
    import zenoh

    _Subscriber = zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]
    _HandleSample = Callable[[str, zenoh.Sample], None]

Receive = Callable[[str, bytes, bytes], None]
"""Handles a message: its key, or the robot of a reply on a local link, the envelope and the payload.

It must not block. What it raises is logged."""

_CAPACITY: Final = 64
"""Messages that wait for the reader of a subscription; the engine itself holds many more in its link."""
_MAX_TOKENS: Final = 65_536
"""The same of tokens. The engine passes on all that are present before the reader begins, so they must fit: a fleet of
more robots would never be connected."""
_DECLARE_AT: Final = 8
"""Uses of a key after which it is declared."""
_MAX_KEYS: Final = 4096
"""Keys sent that are counted or declared, and as many received; messages of further ones carry the key as text."""


class Transport:
    """Messages over one open session, which outlives it.

    If they are relayed, a router passes them on, and may drop those that are not vital.
    """

    def __init__(self, session: zenoh.Session) -> None:
        import zenoh

        self.session: Final = session
        self.is_relayed: Final = bool(session.info.routers_zid())
        self._priorities = zenoh.Priority.DATA, zenoh.Priority.REAL_TIME
        self._congestion = zenoh.CongestionControl.DROP, zenoh.CongestionControl.BLOCK
        self._subscribers: list[_Subscriber] = []
        self._elsewhere = zenoh.Locality.REMOTE
        self._publishers: tuple[dict[str, zenoh.Publisher], ...] = {}, {}  # of messages that are not vital, and vital
        self._received: dict[str, zenoh.KeyExpr] = {}
        self._uses: tuple[dict[str, int], ...] = {}, {}
        self._receipts: dict[str, int] = {}
        engine_exit.keep_at_exit(self)

    def put(
        self,
        key: str,
        envelope: bytes | None,
        payload: Payload = b"",
        *,
        is_urgent: bool = False,
        is_last: bool = True,
        is_vital: bool = True,
    ) -> bool:
        """Send a message; returns False if it could not be sent.

        An urgent one overtakes the messages that wait in the link. One that is not the last may be sent with the next
        as a batch. A vital one waits for a full link; others are dropped there. Thread: any that may wait; blocks only
        while a link is full, at most until the engine closes that link.
        """
        publisher = self._publishers[is_vital].get(key)
        content = payload if type(payload) is bytes else bytes(payload)
        if engine_exit.has_begun:
            return False
        try:
            if publisher is not None and is_last and not is_urgent:
                publisher.put(content, attachment=envelope)
                return True
            if publisher is None and _count(self._uses[is_vital], key):
                self._declare_publisher(key, is_vital=is_vital)
            self.session.put(
                key if publisher is None else publisher.key_expr,
                content,
                attachment=envelope,
                priority=self._priorities[is_urgent],
                congestion_control=self._congestion[is_vital],
                express=is_last,
                allowed_destination=self._elsewhere,
            )
        except Exception as error:  # noqa: BLE001  # zenoh's own: the link broke, or the session is being closed
            get_logger().debug("a message could not be sent", key=key, reason=error_text(error))
            return False
        return True

    def _declare_publisher(self, key: str, *, is_vital: bool) -> None:
        self._publishers[is_vital][key] = self.session.declare_publisher(
            key,
            priority=self._priorities[0],
            congestion_control=self._congestion[is_vital],
            express=True,
            allowed_destination=self._elsewhere,
        )

    def receive(self, key: str, name: str, handle: Receive) -> Callable[[], None]:
        """Pass the messages of a key expression to a handler, in a thread of their own with that name.

        Returns a function that ends it; harmless if the session is closed.
        """

        def handle_sample(received: str, sample: zenoh.Sample) -> None:
            attachment = sample.attachment
            handle(received, b"" if attachment is None else attachment.to_bytes(), sample.payload.to_bytes())

        return self.receive_samples(key, name, handle_sample)

    def receive_samples(self, key: str, name: str, handle: _HandleSample) -> Callable[[], None]:
        """Do the same with a handler that gets the key and the engine's message, whose payload is not yet copied."""
        import zenoh

        return self._read(self.session.declare_subscriber(key, zenoh.handlers.FifoChannel(_CAPACITY)), name, handle)

    def receive_tokens(self, key: str, name: str, handle: Callable[[str, bool], None]) -> Callable[[], None]:
        """Pass the liveliness tokens of a key expression, present and coming, to a handler; see `receive`.

        The handler gets the key of each token, and whether it appeared or disappeared.
        """
        import zenoh

        liveliness = self.session.liveliness()
        subscriber = liveliness.declare_subscriber(key, zenoh.handlers.FifoChannel(_MAX_TOKENS), history=True)
        is_put = zenoh.SampleKind.PUT
        return self._read(subscriber, name, lambda received, sample: handle(received, sample.kind == is_put))

    def _read(self, subscriber: _Subscriber, name: str, handle: _HandleSample) -> Callable[[], None]:
        import zenoh

        channel = subscriber.handler  # a subscriber that is being read itself cannot be undeclared
        self._subscribers.append(subscriber)  # it ends when it is forgotten

        def read() -> None:
            with contextlib.suppress(zenoh.ZError):  # it has ended
                sample: zenoh.Sample | None = None
                while not engine_exit.is_over:
                    if sample is None:
                        sample = channel.recv()
                    received = str(sample.key_expr)
                    try:
                        if not engine_exit.has_begun:
                            if received not in self._received and _count(self._receipts, received):
                                self._received[received] = self.session.declare_keyexpr(received)
                            handle(received, sample)
                    except Exception as error:  # noqa: BLE001  # one bad message must not end the thread
                        get_logger().exception("a message was not handled", key=received, error=error_text(error))
                    sample = channel.try_recv()  # keeps the interpreter's lock, which busy threads give up late

        def end() -> None:
            with contextlib.suppress(zenoh.ZError, ValueError):  # the session is closed, or it has ended
                self._subscribers.remove(subscriber)
                subscriber.undeclare()  # type: ignore[no-untyped-call]  # untyped in zenoh's stubs

        engine_exit.start_thread(read, name)
        return end


def _count(uses: dict[str, int], key: str) -> bool:
    """Count a use of a key; return whether it is to be declared now."""
    before = uses.get(key, 0)
    if before or len(uses) < _MAX_KEYS:
        uses[key] = before + 1
    return before == _DECLARE_AT
