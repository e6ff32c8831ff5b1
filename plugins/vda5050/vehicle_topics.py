"""VehicleTopics: the connection of one vehicle to the broker, and the topics of the standard."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from eal_actors.plugin import Clock, DataError

from ..mqtt.connection import MqttConnection, MqttMessage, TopicInbox
from ..mqtt.plugin import client_name
from .messages import Connection, Headers, InstantActions, Order, Part, decode, encode
from .settings import BridgeSettings

_DEPTH: Final = 16
_FIRST_S: Final = 2.0


class VehicleTopics:
    """The topics of one vehicle.

    Args:
        name: its serial number, the robot's name.
    """

    def __init__(self, name: str, settings: BridgeSettings, clock: Clock) -> None:
        self._prefix = f"{settings.interface}/v2/{settings.manufacturer}/{name}"
        self._headers = Headers(settings.manufacturer, name)
        self._is_new = False
        self._connection = MqttConnection(
            settings, clock, client_name(name), self._presence("CONNECTIONBROKEN"), self._greet
        )
        self._orders = self._connection.subscribe(f"{self._prefix}/order", depth=_DEPTH)
        self._instant = self._connection.subscribe(f"{self._prefix}/instantActions", depth=_DEPTH)
        self._connection.open()

    def await_broker(self) -> None:
        """Wait for the broker's first answer, for a short time. Thread: blocks the caller."""
        self._connection.wait_until(lambda: self.why_not_ready() is None, _FIRST_S)

    def orders(self) -> Iterator[Order | DataError]:
        """Take the orders that have arrived; of one that is none, the reason."""
        return self._received(self._orders, Order)

    def instant_actions(self) -> Iterator[InstantActions | DataError]:
        """Take the instant actions that have arrived, likewise."""
        return self._received(self._instant, InstantActions)

    def header(self, topic: str) -> dict[str, Any]:
        """Return the fields of the next message of a topic."""
        return self._headers.next(topic)

    def send(self, topic: str, message: Part, *, retain: bool = False) -> None:
        """Publish a message.

        Raises:
            EALError: the broker is out of reach.
        """
        self._connection.publish(MqttMessage(f"{self._prefix}/{topic}", encode(message), retain=retain))

    def take_greeting(self) -> bool:
        """Return whether the connection is new since the last call."""
        is_new, self._is_new = self._is_new, False
        return is_new

    def why_not_ready(self) -> str | None:
        """Return why the broker is out of reach; None if it is not."""
        return self._connection.why_not_ready()

    def close(self) -> None:
        """Say farewell."""
        self._connection.close(self._presence("OFFLINE"))

    def _received(self, inbox: TopicInbox, kind: Any) -> Iterator[Any]:
        while True:
            try:
                received = inbox.take()
                if received is None:
                    return
                if received.is_retained:
                    raise DataError(f"{inbox.topic}: a retained message may be old, and is ignored")
                yield decode(kind, received.payload)
            except DataError as error:
                yield error

    def _presence(self, state: Any) -> MqttMessage:
        message = Connection(**self._headers.next("connection"), connection_state=state)
        return MqttMessage(f"{self._prefix}/connection", encode(message), qos=1, retain=True)

    def _greet(self) -> MqttMessage:
        """Return the first message of a new connection. Thread: the client's."""
        self._is_new = True
        return self._presence("ONLINE")
