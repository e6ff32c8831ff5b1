"""The mqtt plugin: a device behind an MQTT broker, with topics as resources."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from functools import partial
from typing import Final

from eal_actors.plugin import DataError, FactoryPlugin, PluginContext, Resource

from .connection import MqttConnection, MqttMessage, MqttReceived, TopicInbox
from .resources import MqttReader, MqttWriter
from .settings import AnnounceSettings, PresenceSettings, Settings

__all__ = ["Settings"]

_FIRST_S: Final = 1.0
"""A broker sends what it has retained at once."""


class MqttPlugin(FactoryPlugin):
    """One device's connection to the broker."""

    def __init__(
        self, connection: MqttConnection, makers: dict[str, Callable[[], Resource]], farewell: MqttMessage | None
    ) -> None:
        super().__init__(makers)
        self.connection = connection
        self.farewell = farewell


class Presence:
    """The device's presence: its own topic, which the broker sets by the device's last will."""

    def __init__(self, connection: MqttConnection, settings: PresenceSettings | None) -> None:
        self._connection = connection
        self._settings = settings
        self._inbox = None if settings is None else connection.subscribe(settings.topic, qos=1, max_bytes=1024)
        self._newest: MqttReceived | None = None

    def why_not_ready(self) -> str | None:
        """Return why the device cannot be reached now. Thread: any."""
        if (problem := self._connection.why_not_ready()) is not None or self._settings is None or self._inbox is None:
            return problem
        try:
            while (received := self._inbox.take()) is not None:
                self._newest = received
        except DataError as error:
            return error.message
        newest = self._newest
        if newest is None or newest.arrived_s < self._connection.connected_s:  # else the broker had sent it again
            said = "nothing"
        elif (text := newest.payload.decode(errors="replace")) == self._settings.online:
            return None
        else:
            said = repr(text[:40])
        return f"the device is absent: {self._settings.topic} says {said}, not {self._settings.online!r}"


def connect(context: PluginContext) -> MqttPlugin:
    """Open the connection; an absent broker is not ready, and reached when it appears.

    Raises:
        PluginError: a certificate or the password cannot be read.

    Thread: the robot's; blocks at most a second of the fleet's clock.
    """
    settings: Settings = context.settings
    announce = settings.announce
    connection = MqttConnection(
        settings,
        context.clock,
        client_name(context.robot),
        will=None if announce is None else _said(announce, announce.offline),
        greeting=None if announce is None else partial(_said, announce, announce.online),
    )
    presence = Presence(connection, settings.presence)
    makers: dict[str, Callable[[], Resource]] = {}
    inboxes: list[TopicInbox] = []
    for name, topic in settings.topics.items():
        if topic.writable:
            makers[name] = partial(MqttWriter, topic, connection, presence.why_not_ready)
        else:
            inbox = connection.subscribe(topic.topic, qos=topic.qos, max_bytes=topic.max_bytes)
            inboxes.append(inbox)
            makers[name] = partial(MqttReader, topic, inbox, context.clock, presence.why_not_ready)
    connection.open()
    connection.wait_until(
        lambda: connection.why_not_ready() is None and all(inbox.has_message for inbox in inboxes), _FIRST_S
    )
    return MqttPlugin(connection, makers, None if announce is None else _said(announce, announce.offline))


def client_name(robot: str) -> str:
    """Return a name for a client at a broker that no other has."""
    return f"eal-{robot[:40]}-{uuid.uuid4().hex[:8]}"


def _said(announce: AnnounceSettings, text: str) -> MqttMessage:
    return MqttMessage(announce.topic, text.encode(), qos=1, retain=True)


def disconnect(plugin: MqttPlugin) -> None:
    """Close the connection."""
    plugin.connection.close(plugin.farewell)
