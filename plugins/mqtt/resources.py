"""Topics as resources."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    Clock,
    DataError,
    DataType,
    EALData,
    NotReadyError,
    Resource,
    ResourceType,
    ValueInfo,
    finite_json,
)

from .connection import MqttConnection, MqttMessage, MqttReceived, TopicInbox, age_text
from .settings import MqttTopicSettings

_TYPES: Final = {"number": DataType.DOUBLE, "flag": DataType.BOOL, "text": DataType.CHAR, "json": DataType.CHAR}

_RETRY_S: Final = 0.1

WhyNotReady = Callable[[], str | None]


def value_info(settings: MqttTopicSettings) -> ValueInfo:
    """Return the type of a topic's values."""
    return ValueInfo(_TYPES[settings.value], settings.unit, description=f"topic {settings.topic}")


class MqttReader(Resource):
    """The newest message of a topic.

    Args:
        why_not_ready: of the connection and the device.
    """

    types = ResourceType.SENSOR

    def __init__(
        self, settings: MqttTopicSettings, inbox: TopicInbox, clock: Clock, why_not_ready: WhyNotReady
    ) -> None:
        self._settings = settings
        self._inbox = inbox
        self._clock = clock
        self._why_not_ready = why_not_ready
        self._newest: MqttReceived | None = None
        self._problem: DataError | None = None
        self.value = value_info(settings)  # type: ignore[misc]  # of each resource its own
        self.description = f"The newest message of {settings.topic}."  # type: ignore[misc]

    def _refresh(self) -> None:
        try:
            while (received := self._inbox.take()) is not None:
                known = b"" if self._newest is None else self._newest.payload
                if not (received.is_retained and received.payload == known):  # else it is sent after each reconnect
                    self._newest = received
                self._problem = None
        except DataError as error:
            self._newest, self._problem = None, error

    @override
    def not_ready(self) -> str | None:
        self._refresh()
        if self._problem is not None:  # get_value raises it
            return None
        return self._why_not_ready() or self._why_silent()

    def _why_silent(self) -> str | None:
        newest, now_s, limit_s = self._newest, self._clock.now(), self._settings.timeout_s
        silence = f"no message on {self._inbox.topic}"
        if newest is None:
            return f"{silence} yet"
        if limit_s is not None and newest.is_retained:  # nobody knows for how long
            return f"{silence} but the one that the broker had retained"
        if limit_s is not None and now_s - newest.arrived_s > limit_s:
            return f"{silence}{age_text(newest.arrived_s, now_s)}"
        return None

    def get_value(self) -> EALData:
        """Return the newest message.

        Raises:
            DataError: it is too long, or not what the settings say.
            NotReadyError: there is none, or it is too old.
        """
        why = self.not_ready()  # which takes what has arrived
        if self._problem is not None:
            raise self._problem
        if self._newest is None or why is not None:
            raise NotReadyError(why or "no message yet")
        value = decode(self._newest.payload, self._settings)
        return EALData.of(value, unit=self._settings.unit, stamp_s=self._newest.arrived_s)


class MqttWriter(Resource):
    """A topic that is published by set_value."""

    types = ResourceType.ACTUATOR

    def __init__(self, settings: MqttTopicSettings, connection: MqttConnection, why_not_ready: WhyNotReady) -> None:
        self._settings = settings
        self._connection = connection
        self._why_not_ready = why_not_ready
        self._is_halt_due = False
        self.value = value_info(settings)  # type: ignore[misc]  # of each resource its own
        self.description = f"Publishes {settings.topic}."  # type: ignore[misc]

    @override
    def not_ready(self) -> str | None:
        return self._why_not_ready()

    def set_value(self, data: EALData) -> None:
        """Publish a message.

        Raises:
            ArgumentError: the value does not fit the settings.
            UnavailableError: the broker is out of reach.
        """
        self._publish(encode(data.value, self._settings), self._settings.qos)
        self._is_halt_due = False

    @override
    def halt(self) -> None:
        self._is_halt_due = self._settings.halt is not None
        self._try_halt()

    @override
    def background(self) -> Activity:
        """Publish a halt that the broker's absence held up."""
        while True:
            self._try_halt()
            yield _RETRY_S

    def _try_halt(self) -> None:
        if self._is_halt_due and self._settings.halt is not None and self._connection.why_not_ready() is None:
            self._publish(self._settings.halt.encode(), max(1, self._settings.qos))  # sent again after a loss
            self._is_halt_due = False

    def _publish(self, payload: bytes, qos: int) -> None:
        self._connection.publish(MqttMessage(self._settings.topic, payload, qos, self._settings.retain))


def decode(payload: bytes, settings: MqttTopicSettings) -> Any:
    """Return the value in a message.

    Raises:
        DataError: it is not what the settings say.
    """
    try:
        text = payload.decode()
    except UnicodeDecodeError as error:
        raise DataError(f"{settings.topic}: a message is no text: {error}") from None
    found: Any = text if settings.field is None else _field(text, settings)
    if settings.value == "number":
        return _number(found, settings)
    if settings.value == "flag":
        flags = {settings.on: True, settings.off: False}
        if isinstance(found, bool):
            return found
        if str(found) not in flags:
            raise DataError(f"{settings.topic}: {str(found)[:40]!r} is neither {settings.on!r} nor {settings.off!r}")
        return flags[str(found)]
    if settings.value == "json":
        return json.dumps(_json(text, settings.topic) if settings.field is None else found)
    return found if isinstance(found, str) else json.dumps(found)


def _json(text: str, topic: str) -> Any:
    try:
        return finite_json(text)
    except ValueError as error:
        raise DataError(f"{topic}: a message is no JSON: {error}") from None


def _field(text: str, settings: MqttTopicSettings) -> Any:
    found = _json(text, settings.topic)
    for name in (settings.field or "").split("."):
        if not isinstance(found, dict) or name not in found:
            raise DataError(f"{settings.topic}: a message has no field {settings.field!r}")
        found = found[name]
    return found


def _number(found: Any, settings: MqttTopicSettings) -> float:
    try:
        number = math.nan if isinstance(found, bool) else float(found)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not math.isfinite(number):
        raise DataError(f"{settings.topic}: {str(found)[:40]!r} is no finite number")
    return number


def encode(value: Any, settings: MqttTopicSettings) -> bytes:
    """Return the message for a value.

    Raises:
        ArgumentError: it does not fit the settings.
    """
    if settings.value == "number" and not math.isfinite(value):
        raise ArgumentError(f"{settings.topic} takes finite numbers, not {value}")
    if settings.value == "flag" and settings.field is None:
        return (settings.on if value else settings.off).encode()
    if settings.value == "json":
        try:
            value = finite_json(value)
        except ValueError as error:
            raise ArgumentError(f"{settings.topic} takes JSON: {error}") from None
    if settings.field is not None:
        for name in reversed(settings.field.split(".")):
            value = {name: value}
    elif settings.value == "text":
        return str(value).encode()
    return json.dumps(value).encode()
