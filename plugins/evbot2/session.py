"""The driver's protocol session with a base: greeting, orders that are carried out exactly once, and polls."""

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
    ReopeningPort,
    ResourceFaultError,
    UnavailableError,
    get_logger,
)

from .codec import Codec
from .messages import (
    CHANNELS,
    MAX_NUMBER,
    STOPS,
    TAGS,
    VERSION,
    BaseReply,
    BaseRequest,
    BaseWelcome,
    Code,
    OrderChannel,
    Verb,
    WheelStatus,
)
from .session_state import FIRST_RETRY_S, PendingOrder, SessionLease, StatusReading, why_refused
from .watchdog import WatchdogTime

POLL_S: Final = 0.004
"""Poll interval of the port during a wait for a reply."""

_LONGEST_RETRY_S: Final = 0.2
_TRIES: Final = 8
_GREETING_S: Final = 0.2  # interval of greetings
_READING_POLLS: Final = 4
_UNANSWERED_POLLS: Final = 3  # the base is silent after these; a computer that was held up has not asked meanwhile
_ROUNDING_S: Final = 1e-6
_POLLS_KEPT: Final = 16
_WELCOME_NUMBERS: Final = len(BaseWelcome._fields)
_STATUS_NUMBERS: Final = len(WheelStatus._fields)


class BaseSession:
    """Requests and replies over one port, for several resources in threads of their own; exactly one of them polls.

    Args:
        port: to the base.
        model: the expected model, 2 or 3.
        channels: its channels, in the order of the greeting.
        poll_hz: polls a second.
        watchdog_s: the base stops after this time without a message; None to derive it from measured round trips.
        on_reading: receives each status, with the welcome of its lease. Thread: holds the lock.
        name: the robot's name, for messages.

    Thread: any; one lock, which is never held during a wait.
    """

    def __init__(
        self,
        port: ReopeningPort,
        codec: Codec[BaseReply, BaseRequest],
        clock: Clock,
        *,
        model: int,
        channels: tuple[OrderChannel, ...],
        poll_hz: float,
        watchdog_s: float | None,
        on_reading: Callable[[BaseWelcome, StatusReading], None],
        name: str,
    ) -> None:
        self.clock: Final = clock
        self.name: Final = name
        self.period_s: Final = 1.0 / poll_hz
        self._watchdog = WatchdogTime(watchdog_s, self.period_s)
        self._port = port
        self._codec = codec
        self._model = model
        self._channels = channels
        self._on_reading = on_reading
        self._host = secrets.randbelow(MAX_NUMBER) + 1  # identifies this driver to the base
        self._lock = threading.Lock()
        self._lease: SessionLease | None = None
        self._orders: dict[OrderChannel, PendingOrder] = {}
        self._last_stops: list[BaseRequest] = []  # of a lost lease, sent until the base answers a greeting
        self._greeted_s = -math.inf
        self._greeting = 0
        self._asked_s = self.watchdog_s
        self._polled_s: float | None = None
        self._unanswered_count = 0  # polls since the latest reading
        self._absence = f"the base at {port.name} has not answered yet"
        self._reading: StatusReading | None = None
        self._log = get_logger(robot=name)

    @property
    def watchdog_s(self) -> float:
        """The base stops after this time without a message."""
        return self._watchdog.agreed_s

    def why_not_ready(self) -> str | None:
        """Return why the base cannot be used now; None if it can. Does not block."""
        if (reason := self._port.why_not_ready()) is not None:
            return reason
        lease = self._lease
        if lease is None or self._reading is None or lease.opening != self._port.openings:
            return self._absence
        return self._why_stale(self._reading) if self._is_silent else None

    def latest(self) -> StatusReading:
        """Return the latest status.

        Raises:
            NotReadyError: there is none, or it has expired.
        """
        reading = self._reading
        if reading is None or self._lease is None:
            raise NotReadyError(self._port.why_not_ready() or self._absence)
        if (reason := self._why_stale(reading)) is not None:
            raise NotReadyError(reason)
        return reading

    def until_next_reading_s(self) -> float:
        """Return the time until the next status is expected, more than 0."""
        reading = self._reading
        due_s = self.period_s - (self.clock.now() - reading.stamp_s) if reading is not None else 0.0
        return min(max(due_s + POLL_S / 2, POLL_S), self.period_s)

    def _why_stale(self, reading: StatusReading) -> str | None:
        age_s = self.clock.now() - reading.stamp_s
        limit_s = max(_READING_POLLS * self.period_s, self.watchdog_s)
        if age_s <= limit_s + _ROUNDING_S:
            return None
        where = f"the base at {self._port.name}"
        why = f"{where} does not answer: its" if self._is_silent else f"{where} was not polled for too long: its"
        return f"{why} last reading is {age_s:.2f} s old, and is valid for {limit_s:.2f} s"

    @property
    def _is_silent(self) -> bool:
        return self._unanswered_count >= _UNANSWERED_POLLS

    def order(self, verb: Verb, *numbers: int) -> Generator[float, None, int]:
        """Send an order until the base acknowledges it; return its tag.

        Raises:
            NotReadyError: the base is absent.
            ResourceFaultError: it refuses the order.
            UnavailableError: it does not acknowledge the order, or a stop replaced the order.
        """
        channel = CHANNELS[verb]
        with self._lock:
            order = self._begin(verb, *numbers)
        while True:
            with self._lock:
                delay_s = self._advance(channel, order)
            if delay_s is None:
                return order.request.tag
            yield delay_s

    def stop(self, channel: OrderChannel) -> None:
        """Send a stop at once, in place of a pending order; `poll` repeats it until it is acknowledged.

        Raises:
            NotReadyError: the port or the base is absent. The base stops by itself after the watchdog time.
        """
        with self._lock:
            if self._lease is None and self._reading is None:
                return  # it was never connected, so nothing moves
            try:
                self._begin(STOPS[channel])
                self._receive()
            except UnavailableError as error:
                raise type(error)(
                    f"{error.message}; if the robot moves, it stops {self.watchdog_s:g} s after its last message"
                ) from error

    def _begin(self, verb: Verb, *numbers: int) -> PendingOrder:
        lease = self._lease
        if lease is None or lease.opening != self._port.openings:
            raise NotReadyError(self._port.why_not_ready() or self._absence)
        now_s = self.clock.now()
        order = self._orders[CHANNELS[verb]] = PendingOrder(lease.request(verb, numbers), now_s, now_s + FIRST_RETRY_S)
        self._send(order.request)
        return order

    def _advance(self, channel: OrderChannel, order: PendingOrder) -> float | None:
        """Resend an order if due; return the time until the next poll, None when it is acknowledged."""
        self._receive()
        verb = order.request.verb.name
        if order.reply is not None:
            if order.reply.code is not Code.OK:
                raise ResourceFaultError(f"the base at {self._port.name} refuses {verb}: {order.reply.code.name}")
            return None
        if self._orders.get(channel) is not order:
            raise UnavailableError(f"{verb} was not acknowledged by the base at {self._port.name}: {self._why_lost()}")
        self._resend_if_due(order)
        return max(min(POLL_S, order.next_s - self.clock.now()), POLL_S / 4)

    def _resend_if_due(self, order: PendingOrder) -> None:
        now_s = self.clock.now()
        if now_s < order.next_s - _ROUNDING_S:
            return
        if order.tries >= _TRIES:
            times = f"sent {_TRIES} times in {now_s - order.first_s:.2f} s"
            self._lose(f"the base at {self._port.name} does not acknowledge {order.request.verb.name}, {times}")
            raise UnavailableError(self._absence)
        order.tries += 1
        order.retry_s = min(2 * order.retry_s, _LONGEST_RETRY_S)
        order.next_s = now_s + order.retry_s
        self._send(order.request)

    def _why_lost(self) -> str:
        return "a stop replaced it" if self._lease is not None else self._absence

    def poll(self) -> Activity:
        """Greet and poll the base forever; greet it again after an absence. Only one resource may run this."""
        while True:
            begun_s = self.clock.now()
            is_answered = self._answers_to(self._send_due)
            while not is_answered and self.clock.now() - begun_s < self.period_s - _ROUNDING_S:
                yield POLL_S
                is_answered = self._answers_to(self._receive)
            self._unanswered_count = 0 if is_answered else self._unanswered_count + 1
            yield max(0.0, begun_s + self.period_s - self.clock.now())

    def greet(self, timeout_s: float) -> Activity:
        """Wait for the answer to a greeting, at most `timeout_s`."""
        end_s = self.clock.now() + timeout_s
        while self.why_not_ready() is not None and self.clock.now() < end_s:
            self._answers_to(self._send_due)
            if self._port.why_not_ready() is not None:
                return
            yield POLL_S

    def close(self) -> None:
        """End the lease, which stops the base, and close the port; has no effect if it is closed."""
        with self._lock:
            lease, self._lease = self._lease, None
            if lease is not None:
                with contextlib.suppress(UnavailableError):  # then it stops by its watchdog
                    self._send(BaseRequest(Verb.BYE, 0, lease.welcome.lease))
        self._port.close()

    def _answers_to(self, step: Callable[[], None]) -> bool:
        """Run a step of the session; return whether it brought a new reading."""
        with self._lock:
            before = self._reading
            try:
                step()
                self._receive()
            except UnavailableError as error:
                self._lose(error.message)
            return self._reading is not before

    def _send_due(self) -> None:
        """Send the due message: a greeting, unacknowledged stops, or a poll."""
        lease = self._lease
        if lease is not None and lease.opening != self._port.openings:
            self._lose(f"the base at {self._port.name} was absent and has not answered since")
            lease = None
        if lease is None:
            self._greet()
            return
        stops = [order for order in self._orders.values() if order.request.verb in STOPS.values()]
        pending = [order for order in stops if order.reply is None]
        for order in pending:  # until a stop has arrived, nothing else may reset the watchdog
            self._resend_if_due(order)
        if pending:
            self._polled_s = None  # no poll is due, so the next interval measures nothing
        else:
            if self._watchdog.due_s() is not None:
                self._greet()  # the lease stays, with another watchdog time
            lease.polled, now_s = (lease.polled + 1) % TAGS, self.clock.now()
            if self._polled_s is not None:
                self._watchdog.measure(now_s - self._polled_s)
            lease.sent_s[lease.polled] = self._polled_s = now_s
            while len(lease.sent_s) > _POLLS_KEPT:
                del lease.sent_s[next(iter(lease.sent_s))]
            self._send(BaseRequest(Verb.STAT, lease.polled, lease.welcome.lease))

    def _greet(self) -> None:
        if self._port.why_not_ready() is not None or self.clock.now() < self._greeted_s + _GREETING_S - _ROUNDING_S:
            return
        self._greeted_s, self._greeting = self.clock.now(), (self._greeting + 1) % TAGS
        self._asked_s = self._watchdog.due_s() or self.watchdog_s
        if self._lease is None:
            self._codec.reset()
            self._send_last_stops()  # before the greeting: a refusal must not be taken for one of the next lease
        self._send(BaseRequest(Verb.HELLO, self._greeting, 0, (VERSION, round(self._asked_s * 1000), self._host)))

    def _lose(self, reason: str) -> None:
        """End the lease and stop the base, which may have received a pending order; it must be greeted again."""
        lease, self._lease = self._lease, None
        self._absence, self._polled_s = reason, None
        self._orders.clear()
        if lease is not None:
            self._log.warning("the base must be greeted again", reason=reason)
            self._last_stops = [lease.request(STOPS[channel]) for channel in self._channels]
            self._send_last_stops()

    def _send_last_stops(self) -> None:
        with contextlib.suppress(UnavailableError):  # without a port it stops by its watchdog
            for request in self._last_stops:
                self._send(request)

    def _send(self, request: BaseRequest) -> None:  # this and all below: the caller holds the lock
        self._port.write(self._codec.encode(request))

    def _receive(self) -> None:
        if self._port.why_not_ready() is not None:
            return
        while data := self._port.read():
            for reply in self._codec.feed(data):
                self._handle(reply)

    def _handle(self, reply: BaseReply) -> None:
        if reply.verb is Verb.HELLO:
            self._handle_welcome(reply)
            return
        lease = self._lease
        if lease is None:
            return
        if reply.code is Code.LEASE:
            self._handle_lapse(reply, lease)
        elif reply.verb is Verb.STAT:
            sent_s = lease.sent_s.pop(reply.tag, None)
            if sent_s is not None:
                self._watchdog.measure(self.clock.now() - sent_s)
            if reply.code is Code.OK and sent_s is not None:
                self._handle_status(lease, reply, sent_s)
        elif (channel := CHANNELS.get(reply.verb)) is not None:
            order = self._orders.get(channel)
            if order is not None and (order.request.verb, order.request.tag) == (reply.verb, reply.tag):
                order.reply = reply
                if reply.code is Code.OK:
                    self._handle_status(lease, reply, order.first_s)

    def _handle_lapse(self, reply: BaseReply, lease: SessionLease) -> None:
        """End the lease if the reply answers a request of this lease."""
        sent = [order.request for order in self._orders.values()]
        is_ours = reply.tag in lease.sent_s or any((it.verb, it.tag) == (reply.verb, reply.tag) for it in sent)
        if is_ours:
            self._lose(f"the base at {self._port.name} received nothing for {self.watchdog_s:g} s and has stopped")
            self._last_stops.clear()
            self._greeted_s = -math.inf

    def _handle_welcome(self, reply: BaseReply) -> None:
        if reply.tag != self._greeting:
            return
        if self._lease is not None:
            self._confirm_watchdog(reply, self._lease)
            return
        if reply.code is not Code.OK or len(reply.numbers) != _WELCOME_NUMBERS + 1 + len(self._channels):
            self._absence = why_refused(f"the base at {self._port.name}", reply)
            return
        welcome = BaseWelcome(*reply.numbers[:_WELCOME_NUMBERS])
        polled, *tags = reply.numbers[_WELCOME_NUMBERS:]
        if welcome.model != self._model:
            self._absence = f"the base at {self._port.name} is an EvBot {welcome.model}, not an EvBot {self._model}"
            return
        self._watchdog.agreed_s = self._asked_s
        self._last_stops.clear()
        self._lease = SessionLease(welcome, self._port.openings, polled, dict(zip(self._channels, tags, strict=True)))
        self._log.debug("the base has answered", port=self._port.name, lease=welcome.lease)
        for channel in self._channels:  # stop the motion of a previous driver
            self._begin(STOPS[channel])

    def _confirm_watchdog(self, reply: BaseReply, lease: SessionLease) -> None:
        """Note the watchdog time that the base has taken for the running lease."""
        same = BaseWelcome._fields.index("lease")
        if reply.code is Code.OK and reply.numbers[same : same + 1] == (lease.welcome.lease,):
            if self._watchdog.agreed_s != self._asked_s:
                self._log.info("another watchdog time", watchdog_s=round(self._asked_s, 2))
            self._watchdog.agreed_s = self._asked_s

    def _handle_status(self, lease: SessionLease, reply: BaseReply, sent_s: float) -> None:
        if len(reply.numbers) < _STATUS_NUMBERS:
            return
        wheels = WheelStatus(*reply.numbers[:_STATUS_NUMBERS])
        if lease.uptime_ms is not None and (wheels.uptime_ms - lease.uptime_ms) % (MAX_NUMBER + 1) > MAX_NUMBER // 2:
            return  # a newer one arrived before it
        lease.uptime_ms = wheels.uptime_ms
        if self._reading is not None:  # by its uptime it is no older than the one before
            sent_s = max(sent_s, self._reading.stamp_s)
        reading = StatusReading(sent_s, wheels, reply.numbers[_STATUS_NUMBERS:])
        self._on_reading(lease.welcome, reading)
        self._reading = reading
