"""The settings of the mqtt plugin in the fleet file, and those of every connection to a broker."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import AfterValidator

from eal_actors.plugin import Field, PluginSettingsModel

_MOST_BYTES: Final = 65535


def check_topic(topic: str) -> str:
    """Return a topic to publish or subscribe: one, without wildcards.

    Raises:
        ValueError: it is empty, too long, or has a wildcard.
    """
    if not topic or len(topic.encode()) > _MOST_BYTES or any(sign in topic for sign in "+#\0"):
        raise ValueError("a topic has 1 to 65535 bytes, without the wildcards + and #")
    return topic


Topic = Annotated[str, AfterValidator(check_topic)]
ResourceName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


class BrokerSettings(PluginSettingsModel):
    """A connection to a broker."""

    broker: str = Field(
        default="mqtt://127.0.0.1:1883", pattern=r"^mqtts?://(\[[0-9A-Fa-f:.]+\]|[^/@:\s]+)(:\d{1,5})?$"
    )
    """The broker: `mqtt://HOST:PORT`, or `mqtts://HOST:PORT` with TLS; the default ports are 1883 and 8883."""
    protocol: Literal["5", "3.1.1"] = "5"
    """Version of MQTT that the broker speaks."""
    username: str | None = None
    """Name of the user at the broker."""
    password_file: str | None = None
    """File whose first line is the password."""
    ca: str | None = None
    """File of the certificate authority that signed the broker's certificate; None for the system's authorities."""
    certificate: str | None = None
    """File of the own certificate, for brokers that ask for one."""
    key: str | None = None
    """File of the certificate's key."""


class MqttTopicSettings(PluginSettingsModel):
    """A topic as a resource."""

    topic: Topic
    """Its name."""
    value: Literal["text", "number", "flag", "json"] = "text"
    """The kind of its messages."""
    field: str | None = None
    """The value is this field of a JSON object; names of nested fields are joined by dots."""
    unit: str | None = None
    """Unit of a number, such as `degC`."""
    on: str = "true"
    """The message of a flag that is set."""
    off: str = "false"
    """The message of a flag that is not set."""
    writable: bool = False
    """Whether set_value publishes it; then the resource does not subscribe."""
    retain: bool = False
    """Whether the broker keeps a published message for later subscribers."""
    qos: Literal[0, 1, 2] = 0
    """Quality of service. A message of 1 or 2 that was under way when the broker was lost is sent again."""
    halt: str | None = None
    """The message that is published at every halt; for what moves or heats."""
    timeout_s: float | None = Field(default=None, gt=0, le=86400)
    """Silence after which the resource is not ready, in seconds of the fleet's clock; None for none. A message that the
    broker had retained does not end it."""
    max_bytes: int = Field(default=65536, ge=1, le=1 << 24)
    """Longest message that is read."""


class PresenceSettings(PluginSettingsModel):
    """The topic that says whether the device is there: the device publishes it, and the broker its last will."""

    topic: Topic
    """Its name."""
    online: str = "online"
    """Its message while the device is there."""


class AnnounceSettings(PluginSettingsModel):
    """The topic that says whether this program is there: retained, with a last will."""

    topic: Topic
    """Its name."""
    online: str = "online"
    """Its message while this program is connected."""
    offline: str = "offline"
    """Its message otherwise."""


class Settings(BrokerSettings):
    """The plugin's settings in the fleet file."""

    topics: dict[ResourceName, MqttTopicSettings] = Field(min_length=1)
    """Topics as resources, by the resources' names."""
    presence: PresenceSettings | None = None
    """Presence of the device; its resources are not ready while it is absent."""
    announce: AnnounceSettings | None = None
    """Presence of this program, for the device."""
