"""The driver's side of the talk with a base: greeting, orders that are carried out once, polls, and the way back."""

from __future__ import annotations

import contextlib
import math
import secrets
import threading
from collections.abc import Callable, Generator
from typing import Final

from eal_actors.plugin import (
    Activity,
    Clock,
    NotReadyError,
    ResourceFaultError,
    UnavailableError,
    get_logger,
)

from .messages import (
    CHANNELS,
    MAX_NUMBER,
    STOPS,
    TAGS,
    VERSION,
    Channel,
    Code,
    Reply,
    Request,
    Verb,
    Welcome,
    WheelStatus,
)
from .session import FIRST_RETRY_S, HostSide, Order, Reading, Session, Way

LOOK_S: Final = 0.004
"""How often to look whether a reply has come."""

_LONGEST_RETRY_S: Final = 0.2
_TRIES: Final = 8
_GREETING_S: Final = 0.2  # between two greetings
_POLLS_A_READING_LASTS: Final = 4
_ROUNDING_S: Final = 1e-6
_POLLS_KEPT: Final = 16
_WELCOME_NUMBERS: Final = len(Welcome._fields)
_STATUS_NUMBERS: Final = len(WheelStatus._fields)


class Talk:
    """Requests and replies over one way, for several resources in threads of their own; exactly one of them polls.

    Args:
        way: to the base.
        codec: how the base speaks.
        clock: the fleet's clock.
        model: what the base must be: 2 or 3, as its greeting says.
        channels: what it moves, in the order of the greeting.
        poll_hz: polls a second.
        watchdog_s: the base stops when it hears nothing for so long.
        on_reading: told of each status, with the welcome that it belongs to. Thread: holds the lock.
        name: the robot's, for messages.

    Thread: any; one lock, which is never held during a wait.
    """

    def __init__(
        self,
        way: Way,
        codec: HostSide,
        clock: Clock,
        *,
        model: int,
        channels: tuple[Channel, ...],
        poll_hz: float,
        watchdog_s: float,
        on_reading: Callable[[Welcome, Reading], None],
        name: str,
    ) -> None:
        self.clock: Final = clock
        self.name: Final = name
        self.period_s: Final = 1.0 / poll_hz
        self.watchdog_s: Final = watchdog_s
        self._way = way
        self._codec = codec
        self._model = model
        self._channels = channels
        self._on_reading = on_reading
        self._host = secrets.randbelow(MAX_NUMBER) + 1  # tells this driver from any other that greets the base
        self._lock = threading.Lock()
        self._session: Session | None = None
        self._orders: dict[Channel, Order] = {}
        self._greeted_s = -math.inf
        self._greeting = 0
        self._why_silent = f"the base at {way.name} has not answered yet"
        self._reading: Reading | None = None
        self._log = get_logger(robot=name)

    # State.

    def why_not_ready(self) -> str | None:
        """Return why the base cannot be used at present; None if it can. Does not wait."""
        if (reason := self._way.why_not_ready()) is not None:
            return reason
        if self._session is None or self._reading is None:
            return self._why_silent
        return self._why_stale(self._reading)

    def latest(self) -> Reading:
        """Return the latest reading.

        Raises:
            NotReadyError: there is none, or it is too old to count.
        """
        reading = self._reading
        if reading is None or self._session is None:
            raise NotReadyError(self._way.why_not_ready() or self._why_silent)
        if (reason := self._why_stale(reading)) is not None:
            raise NotReadyError(reason)
        return reading

    def next_look_s(self) -> float:
        """Return how long to wait for the reading after the latest one, more than 0."""
        reading = self._reading
        due_s = self.period_s - (self.clock.now() - reading.stamp_s) if reading is not None else 0.0
        return min(max(due_s + LOOK_S / 2, LOOK_S), self.period_s)

    def _why_stale(self, reading: Reading) -> str | None:
        age_s, limit_s = (
            self.clock.now() - reading.stamp_s,
            max(_POLLS_A_READING_LASTS * self.period_s, self.watchdog_s),
        )
        if age_s <= limit_s + _ROUNDING_S:
            return None
        return (
            f"the base at {self._way.name} does not answer: its last reading is {age_s:.2f} s old, "
            f"and counts for {limit_s:.2f} s"
        )

    # Orders.

    def order(self, verb: Verb, *numbers: int) -> Generator[float, None, int]:
        """Send an order until the base acknowledges it; return its tag.

        Raises:
            NotReadyError: the base is away.
            ResourceFaultError: it refuses the order.
            UnavailableError: it does not acknowledge it, or a stop took its place.
        """
        channel = CHANNELS[verb]
        with self._lock:
            order = self._begin(channel, verb, numbers)
        while True:
            with self._lock:
                delay_s = self._push(channel, order)
            if delay_s is None:
                return order.request.tag
            yield delay_s

    def stop(self, channel: Channel) -> None:
        """Send a stop at once, in place of what is under way; the poll sends it again until it is acknowledged.

        Raises:
            UnavailableError: it does not go out. The base stops by itself after the watchdog time.
        """
        with self._lock:
            if self._session is None and self._reading is None:
                return  # it has never been there, so nothing moves
            try:
                self._begin(channel, STOPS[channel], ())
                self._receive()
            except UnavailableError as error:
                raise UnavailableError(
                    f"{error.message}; if it moves, it stops by itself {self.watchdog_s:g} s after it heard anything"
                ) from error

    def _begin(self, channel: Channel, verb: Verb, numbers: tuple[int, ...]) -> Order:
        session = self._session
        if session is None:
            raise NotReadyError(self._way.why_not_ready() or self._why_silent)
        tag = session.tags[channel] = (session.tags[channel] + 1) % TAGS
        now_s = self.clock.now()
        order = Order(Request(verb, tag, session.welcome.lease, numbers), now_s, now_s + FIRST_RETRY_S)
        self._orders[channel] = order
        self._send(order.request)
        return order

    def _push(self, channel: Channel, order: Order) -> float | None:
        """Go on with an order; return the time until the next look, None when it is acknowledged."""
        self._receive()
        what = order.request.verb.name
        if order.reply is not None:
            if order.reply.code is not Code.OK:
                raise ResourceFaultError(f"the base at {self._way.name} refuses {what}: {order.reply.code.name}")
            return None
        if self._orders.get(channel) is not order:
            raise UnavailableError(f"{what} was not acknowledged by the base at {self._way.name}: {self._why_lost()}")
        self._resend_if_due(order)
        return max(min(LOOK_S, order.next_s - self.clock.now()), LOOK_S / 4)

    def _resend_if_due(self, order: Order) -> None:
        now_s = self.clock.now()
        if now_s < order.next_s - _ROUNDING_S:
            return
        if order.tries >= _TRIES:
            times = f"which was sent {_TRIES} times in {now_s - order.first_s:.2f} s"
            self._lose(f"the base at {self._way.name} does not acknowledge {order.request.verb.name}, {times}")
            raise UnavailableError(self._why_silent)
        order.tries += 1
        order.retry_s = min(2 * order.retry_s, _LONGEST_RETRY_S)
        order.next_s = now_s + order.retry_s
        self._send(order.request)

    def _why_lost(self) -> str:
        return "a stop took its place" if self._session is not None else self._why_silent

    # Polls.

    def poll(self) -> Activity:
        """Greet the base, poll it again and again, and greet it anew when it was away: for ever. Only one may do so."""
        while True:
            begun_s = self.clock.now()
            is_heard = self._heard_after(self._ask)
            while not is_heard and self.clock.now() - begun_s < self.period_s - _ROUNDING_S:
                yield LOOK_S
                is_heard = self._heard_after(self._receive)
            yield max(0.0, begun_s + self.period_s - self.clock.now())

    def greet(self, timeout_s: float) -> Activity:
        """Give the base a while to answer the greeting, for what wants it to be there at once."""
        end_s = self.clock.now() + timeout_s
        while self.why_not_ready() is not None and self.clock.now() < end_s:
            self._heard_after(self._ask)
            if self._way.why_not_ready() is not None:
                return
            yield LOOK_S

    def close(self) -> None:
        """Take leave of the base, which stops then, and let go of the way to it; harmless if it is closed."""
        with self._lock:
            session, self._session = self._session, None
            if session is not None:
                with contextlib.suppress(UnavailableError):  # then it stops a little later, by its watchdog
                    self._send(Request(Verb.BYE, 0, session.welcome.lease))
        self._way.close()

    def _heard_after(self, step: Callable[[], None]) -> bool:
        """Do a step of the talk; return whether there is a reading from this moment or later than the last step."""
        with self._lock:
            before = self._reading
            try:
                step()
                self._receive()
            except UnavailableError as error:
                self._lose(error.message)
            return self._reading is not before

    def _ask(self) -> None:
        """Send what is due: the greeting, stops that are not acknowledged, or a poll."""
        session = self._session
        if session is not None and session.opening != self._way.openings:
            self._lose(f"the base at {self._way.name} was away, and has not answered since")
            session = None
        if session is None:
            self._greet()
            return
        stops = [order for order in self._orders.values() if order.request.verb in STOPS.values()]
        pending = [order for order in stops if order.reply is None]
        for order in pending:  # until the stop has arrived nothing else may keep the base awake
            self._resend_if_due(order)
        if not pending:
            session.polled = (session.polled + 1) % TAGS
            session.sent_s[session.polled] = self.clock.now()
            while len(session.sent_s) > _POLLS_KEPT:
                del session.sent_s[next(iter(session.sent_s))]
            self._send(Request(Verb.STAT, session.polled, session.welcome.lease))

    def _greet(self) -> None:
        if self._way.why_not_ready() is not None or self.clock.now() < self._greeted_s + _GREETING_S - _ROUNDING_S:
            return
        self._greeted_s, self._greeting = self.clock.now(), (self._greeting + 1) % TAGS
        self._codec.reset()
        self._send(Request(Verb.HELLO, self._greeting, 0, (VERSION, round(self.watchdog_s * 1000), self._host)))

    def _lose(self, reason: str) -> None:
        """Note that the base has to be greeted anew, and that orders under way are lost."""
        if self._session is not None:
            self._log.warning("the base is to be greeted anew", reason=reason)
        self._session, self._why_silent = None, reason
        self._orders.clear()

    # Bytes. Thread: holds the lock.

    def _send(self, request: Request) -> None:
        self._way.write(self._codec.encode(request))

    def _receive(self) -> None:
        if self._way.why_not_ready() is not None:
            return
        while data := self._way.read():
            for reply in self._codec.feed(data):
                self._take(reply)

    def _take(self, reply: Reply) -> None:
        if reply.verb is Verb.HELLO:
            self._take_welcome(reply)
            return
        session = self._session
        if session is None:
            return
        if reply.code is Code.LEASE:
            self._take_lapse(reply, session)
        elif reply.verb is Verb.STAT:
            sent_s = session.sent_s.pop(reply.tag, None)
            if reply.code is Code.OK and sent_s is not None:
                self._take_status(session, reply, sent_s)
        elif (channel := CHANNELS.get(reply.verb)) is not None:
            order = self._orders.get(channel)
            if order is not None and (order.request.verb, order.request.tag) == (reply.verb, reply.tag):
                order.reply = reply
                if reply.code is Code.OK:
                    self._take_status(session, reply, order.first_s)

    def _take_lapse(self, reply: Reply, session: Session) -> None:
        """Note that the lease has lapsed, if the reply is one to what was asked under this lease."""
        asked = [order.request for order in self._orders.values()]
        is_ours = reply.tag in session.sent_s or any((it.verb, it.tag) == (reply.verb, reply.tag) for it in asked)
        if is_ours:
            self._lose(f"the base at {self._way.name} had heard nothing for {self.watchdog_s:g} s, and has stopped")
            self._greeted_s = -math.inf

    def _take_welcome(self, reply: Reply) -> None:
        if self._session is not None or reply.tag != self._greeting:
            return
        if reply.code is not Code.OK or len(reply.numbers) != _WELCOME_NUMBERS + 1 + len(self._channels):
            self._why_silent = self._why_refused(reply)
            return
        welcome = Welcome(*reply.numbers[:_WELCOME_NUMBERS])
        polled, *tags = reply.numbers[_WELCOME_NUMBERS:]
        if welcome.model != self._model:
            self._why_silent = f"at {self._way.name} is an EvBot {welcome.model}, and not an EvBot {self._model}"
            return
        self._session = Session(welcome, self._way.openings, polled, dict(zip(self._channels, tags, strict=True)))
        self._log.debug("the base has answered", port=self._way.name, lease=welcome.lease)
        for channel in self._channels:  # whoever drove it before: from here on it stands
            self._begin(channel, STOPS[channel], ())

    def _why_refused(self, reply: Reply) -> str:
        where = f"the base at {self._way.name}"
        if reply.code is Code.BUSY:
            return f"{where} listens to another host, until that one is silent"
        if reply.code is Code.VERSION:
            return f"{where} does not speak version {VERSION} of the protocol"
        return f"{where} answers the greeting with {reply.code.name} and {len(reply.numbers)} numbers"

    def _take_status(self, session: Session, reply: Reply, sent_s: float) -> None:
        if len(reply.numbers) < _STATUS_NUMBERS:
            return
        wheels = WheelStatus(*reply.numbers[:_STATUS_NUMBERS])
        if (
            session.uptime_ms is not None
            and (wheels.uptime_ms - session.uptime_ms) % (MAX_NUMBER + 1) > MAX_NUMBER // 2
        ):
            return  # it was overtaken by a newer one
        session.uptime_ms = wheels.uptime_ms
        if self._reading is not None:  # it tells no older time than the one before, by the uptime
            sent_s = max(sent_s, self._reading.stamp_s)
        reading = Reading(sent_s, wheels, reply.numbers[_STATUS_NUMBERS:])
        self._on_reading(session.welcome, reading)
        self._reading = reading
