"""MqttConnection: one connection to a broker, which is opened again after a loss.

Nothing is queued for a broker that is away: a command must not be carried out minutes later. Of each topic the newest
messages are kept until they are read, so a flood costs no memory. The client's thread only stores bytes; they are
decoded by the reader. The connection counts as open once the broker has confirmed the subscriptions.

Thread: any, after `open`.
"""

from __future__ import annotations

import math
import ssl
import sys
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from eal_actors.plugin import Clock, DataError, PluginError, UnavailableError, get_logger

from .settings import BrokerSettings

_KEEPALIVE_S: Final = 10
_CONNECT_S: Final = 3.0
_LONGEST_RETRY_S: Final = 5
_POLL_S: Final = 0.02
_CLOSE_S: Final = 2.0
_MOST_BYTES: Final = 1 << 25
"""Longest packet that a broker of MQTT 5 may send."""


@dataclass(frozen=True, slots=True)
class MqttMessage:
    """A message to publish.

    Attributes:
        topic: without wildcards.
        payload: its bytes.
        qos: 0, 1 or 2.
        retain: whether the broker keeps it for later subscribers.
    """

    topic: str
    payload: bytes
    qos: int = 0
    retain: bool = False


@dataclass(frozen=True, slots=True)
class MqttReceived:
    """A message as it arrived.

    Attributes:
        payload: its bytes; empty if they are too many.
        arrived_s: by the fleet's clock.
        is_too_long: whether they are more than are read.
        is_retained: whether the broker had kept it, for how long ever.
    """

    payload: bytes
    arrived_s: float
    is_too_long: bool = False
    is_retained: bool = False


class TopicInbox:
    """The newest messages of one topic."""

    def __init__(self, topic: str, depth: int, max_bytes: int) -> None:
        self.topic: Final = topic
        self._max_bytes = max_bytes
        self._waiting: deque[MqttReceived] = deque(maxlen=depth)

    def put(self, payload: bytes, arrived_s: float, *, is_retained: bool) -> None:
        """Keep a message; the oldest is dropped from a full inbox. Thread: the client's."""
        is_too_long = len(payload) > self._max_bytes
        self._waiting.append(MqttReceived(b"" if is_too_long else payload, arrived_s, is_too_long, is_retained))

    @property
    def has_message(self) -> bool:
        """Whether a message is kept."""
        return bool(self._waiting)

    def take(self) -> MqttReceived | None:
        """Return the oldest message that is kept; None if there is none.

        Raises:
            DataError: it is too long.
        """
        try:
            received = self._waiting.popleft()
        except IndexError:
            return None
        if received.is_too_long:
            raise DataError(f"{self.topic}: a message is longer than {self._max_bytes} bytes")
        return received


class MqttConnection:
    """A connection to a broker; subscribe, then `open` it.

    Args:
        name: identifies the client at the broker; no other may have it.
        will: what the broker publishes if the connection is lost without a farewell.
        greeting: is published whenever the connection is open; a farewell of `close` goes with it.

    Attributes:
        connected_s: when the broker accepted the newest connection, by the fleet's clock.

    Raises:
        PluginError: a file of the settings cannot be read, or is no certificate or key.
    """

    def __init__(
        self,
        settings: BrokerSettings,
        clock: Clock,
        name: str,
        will: MqttMessage | None = None,
        greeting: Callable[[], MqttMessage] | None = None,
    ) -> None:
        self.url: Final = settings.broker
        self.connected_s = -math.inf
        self._clock = clock
        self._inboxes: dict[str, list[TopicInbox]] = {}
        self._qualities: dict[str, int] = {}
        self._greeting = greeting
        self._problem = "not tried yet"
        self._was_open = False
        self._has_failed = False
        self._is_ready = False
        self._ending: threading.Thread | None = None
        self._log = get_logger(broker=self.url)
        self._client = self._make_client(settings, name, will)

    def open(self) -> None:
        """Begin to connect, in a thread of the client, which tries it again until `close`. Does not wait."""
        self._client.loop_start()

    def _make_client(self, settings: BrokerSettings, name: str, will: MqttMessage | None) -> paho.Client:
        is_5, parts = settings.protocol == "5", urlsplit(settings.broker)
        client = paho.Client(
            CallbackAPIVersion.VERSION2,
            client_id=name,
            protocol=paho.MQTTv5 if is_5 else paho.MQTTv311,
            clean_session=None if is_5 else True,
        )
        client.suppress_exceptions = True  # an error of ours must not end the client's thread
        client.connect_timeout = _CONNECT_S
        client.reconnect_delay_set(1, _LONGEST_RETRY_S)
        if settings.username is not None:
            client.username_pw_set(settings.username, _password(settings.password_file))
        if parts.scheme == "mqtts":
            client.tls_set_context(_tls(settings))
        elif settings.ca or settings.certificate:
            raise PluginError(f"certificates need TLS: mqtts:// instead of {settings.broker}")
        if will is not None:
            client.will_set(will.topic, will.payload, will.qos, will.retain)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.on_connect_fail, client.on_message = self._on_connect_fail, self._on_message
        client.on_subscribe = self._on_subscribe
        options: dict[str, Any] = {}
        if is_5:
            limit = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]  # untyped in the client's stubs
            limit.MaximumPacketSize = _MOST_BYTES
            options = {"clean_start": True, "properties": limit}
        port = parts.port or (8883 if parts.scheme == "mqtts" else 1883)
        client.connect_async(parts.hostname or "", port, _KEEPALIVE_S, **options)
        return client

    # The client's thread.

    def _on_connect(self, client: paho.Client, _: Any, __: Any, reason: Any, ___: Any) -> None:
        if reason.is_failure:
            self._problem, self._has_failed = f"it refuses this client: {str(reason).lower()}", True
            return
        self.connected_s = self._clock.now()
        self._problem = "its subscriptions are not confirmed"
        if self._qualities:
            client.subscribe(list(self._qualities.items()))
        else:
            self._begin()

    def _on_subscribe(self, _: paho.Client, __: Any, ___: int, reasons: list[Any], ____: Any) -> None:
        refused = [topic for topic, reason in zip(self._qualities, reasons, strict=False) if reason.is_failure]
        if refused:
            self._problem = f"it refuses the subscription of {', '.join(refused)}"
        else:
            self._begin()

    def _begin(self) -> None:
        if self._greeting is not None:
            self._send(self._greeting())
        if self._was_open:
            self._log.info("the broker is back")
        self._was_open, self._is_ready, self._has_failed, self._problem = True, True, False, ""

    def _on_disconnect(self, _: paho.Client, __: Any, ___: Any, reason: Any, ____: Any) -> None:
        if self._is_ready:
            self._is_ready = False
            self._problem = f"the connection was lost: {str(reason).lower()}"

    def _on_connect_fail(self, _: paho.Client, __: Any) -> None:
        error = sys.exc_info()[1]  # the client calls this while it handles it
        self._problem, self._has_failed = str(getattr(error, "strerror", None) or error).lower(), True

    def _on_message(self, _: paho.Client, __: Any, message: paho.MQTTMessage) -> None:
        for inbox in self._inboxes.get(message.topic, ()):
            inbox.put(bytes(message.payload), self._clock.now(), is_retained=message.retain)

    # The users' threads.

    def subscribe(self, topic: str, *, qos: int = 0, depth: int = 1, max_bytes: int = 1 << 20) -> TopicInbox:
        """Subscribe to a topic, before `open`; its newest `depth` messages are kept until they are taken."""
        inbox = TopicInbox(topic, depth, max_bytes)
        self._inboxes.setdefault(topic, []).append(inbox)
        self._qualities[topic] = max(qos, self._qualities.get(topic, 0))
        return inbox

    def wait_until(self, is_there: Callable[[], bool], within_s: float) -> None:
        """Wait until something holds; not for an absent broker. Thread: blocks the caller."""
        end_s = self._clock.now() + within_s
        while not (is_there() or self._has_failed) and self._clock.now() < end_s:
            self._clock.sleep(_POLL_S)

    def publish(self, message: MqttMessage) -> None:
        """Publish a message.

        Raises:
            UnavailableError: the broker is out of reach; the message is not sent later.

        Thread: any; does not block.
        """
        if (problem := self.why_not_ready()) is not None:
            raise UnavailableError(f"{message.topic} was not published: {problem}")
        self._send(message)

    def _send(self, message: MqttMessage) -> None:
        self._client.publish(message.topic, message.payload, message.qos, message.retain)

    def why_not_ready(self) -> str | None:
        """Return why nothing can be sent or received now."""
        if self._is_ready:
            return None
        return f"cannot reach the MQTT broker at {self.url}: {self._problem}"

    def close(self, farewell: MqttMessage | None = None, *, wait: bool = True) -> None:
        """End the connection with a farewell, so that the broker does not publish the last will.

        A second call waits for the end of the first. Thread: blocks the caller for two real seconds at most, if it
        waits.
        """
        if self._ending is None:
            if farewell is not None and self._is_ready:
                self._send(farewell)
            self._client.disconnect()
            self._ending = threading.Thread(target=self._end, name=f"closing {self.url}", daemon=True)
            self._ending.start()
        if wait:
            with self._clock.outside():
                self._ending.join(_CLOSE_S)

    def _end(self) -> None:
        self._client.loop_stop()
        self._client._reset_sockets()  # noqa: SLF001  # its own pair of sockets, which only its destructor closes


def _password(file: str | None) -> str | None:
    if file is None:
        return None
    try:
        return Path(file).read_text(encoding="utf-8").split("\n", 1)[0]
    except (OSError, UnicodeDecodeError) as error:
        raise PluginError(f"the password cannot be read: {error}") from error


def _tls(settings: BrokerSettings) -> ssl.SSLContext:
    try:
        context = ssl.create_default_context(cafile=settings.ca)
        if settings.certificate is not None:
            context.load_cert_chain(settings.certificate, settings.key)
    except OSError as error:  # ssl.SSLError too
        files = ", ".join(filter(None, (settings.ca, settings.certificate, settings.key)))
        raise PluginError(f"the certificates of the broker cannot be used ({files}): {error}") from error
    return context


def age_text(arrived_s: float, now_s: float) -> str:
    """Return how long a topic has been silent, for messages."""
    return f" for {now_s - arrived_s:.1f} s" if arrived_s > -math.inf else " yet"
