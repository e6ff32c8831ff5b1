"""Topics and services of a ROS 2 robot as resources: typed sensors for common messages, JSON for all others."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np
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
    json_object,
    request,
)

from . import graph
from .endpoints import RosClient, RosPublisher, RosSubscription
from .pictures import decode_compressed, decode_image
from .session import RosSession
from .settings import TopicSettings
from .stamps import StampOffset
from .transforms import TransformTree

_MOST_JSON: Final = 1_000_000
_POLL_S: Final = 0.05
_FIELDS: Final = "a message needs a JSON object such as {}"


class TopicReader:
    """The newest message of one topic, decoded when it is read.

    Args:
        timeout_s: silence after which it is not ready; None for none.
    """

    def __init__(
        self, session: RosSession, subscription: RosSubscription, clock: Clock, timeout_s: float | None
    ) -> None:
        self._session = session
        self._subscription = subscription
        self._clock = clock
        self._timeout_s = timeout_s
        self._offset = StampOffset()
        self._message: Any = None
        self._arrived_s = -math.inf
        self._stamp_s = 0.0

    def refresh(self) -> Any:
        """Take what has arrived; return the newest message, or None.

        Raises:
            DataError: it is no message of the topic's type, or too long.
        """
        while (received := self._subscription.take()) is not None:
            now_s = self._clock.now()
            sent_s = None if received.sent_ns is None else received.sent_ns / 1e9
            self._stamp_s = now_s if sent_s is None else self._offset.fleet_s(sent_s, now_s)
            self._message, self._arrived_s = received.message, now_s
        return self._message

    def why_not_ready(self) -> str | None:
        """Return why the topic is silent; None if it is not."""
        if not self._is_silent():
            return None
        try:
            self.refresh()
        except DataError:  # `read` raises it
            return None
        if not self._is_silent():
            return None
        topic, age_s = self._subscription.topic, self._clock.now() - self._arrived_s
        absent = self._session.why_absent(graph.PUBLISHER, topic, self._subscription.kind)
        return absent or f"no message on {topic}" + (f" for {age_s:.1f} s" if age_s < math.inf else " yet")

    def _is_silent(self) -> bool:
        if self._message is None or self._timeout_s is None:
            return self._message is None
        return self._clock.now() - self._arrived_s > self._timeout_s

    def read(self) -> tuple[Any, float]:
        """Return the newest message, and its time in seconds of the fleet's clock.

        Raises:
            DataError: it is no message of the topic's type, or too long.
            NotReadyError: there is none, or it is too old.
        """
        message, problem = self.refresh(), self.why_not_ready()
        if message is None or problem is not None:
            raise NotReadyError(problem or "no message yet")
        return message, self._stamp_s


class TopicSensor(Resource):
    """The newest message of a topic."""

    types = ResourceType.SENSOR

    def __init__(self, reader: TopicReader, kind: str) -> None:
        self._reader = reader
        self.description = f"The newest {kind}."  # type: ignore[misc]  # of each resource its own

    @override
    def not_ready(self) -> str | None:
        return self._reader.why_not_ready()


class LaserScanSensor(TopicSensor):
    """Distances along the rays of a scan; the greatest range for no hit."""

    value = ValueInfo(DataType.DOUBLE, "m", shape=(None,))

    def get_value(self) -> EALData:
        """Return the distances. A ray without a valid one has the greatest range; one with -inf, too near, the least.

        Source: REP 117.
        """
        scan, stamp_s = self._reader.read()
        ranges = np.asarray(scan.ranges, np.float64)
        valid = np.isfinite(ranges) & (ranges >= scan.range_min) & (ranges <= scan.range_max)
        found = np.where(valid, ranges, float(scan.range_max))
        found = np.where(ranges == -math.inf, float(scan.range_min), found)
        if not np.isfinite(found).all():
            raise DataError("the scan's range_min or range_max is not finite")
        return EALData.of(found, unit="m", frame_id=scan.header.frame_id or None, stamp_s=stamp_s)

    @request("angles", ValueInfo(DataType.DOUBLE, "rad", shape=(None,)))
    def angles(self) -> EALData:
        """Return the rays' angles from straight ahead, counter-clockwise positive."""
        scan, stamp_s = self._reader.read()
        angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
        return EALData.of(angles, unit="rad", frame_id=scan.header.frame_id or None, stamp_s=stamp_s)


class ImageSensor(TopicSensor):
    """Pictures of a camera."""

    value = ValueInfo(DataType.CHAR, shape=(None, None, 3), description="RGB, rows from the top")
    decode = staticmethod(decode_image)

    def get_value(self) -> EALData:
        """Return the newest picture, shape (height, width, 3)."""
        message, stamp_s = self._reader.read()
        return EALData.of(self.decode(message), frame_id=message.header.frame_id or None, stamp_s=stamp_s)


class CompressedImageSensor(ImageSensor):
    """Compressed pictures of a camera."""

    decode = staticmethod(decode_compressed)


class BatterySensor(TopicSensor):
    """The battery's charge, 0 to 1."""

    value = ValueInfo(DataType.DOUBLE, None, 0, 1, description="fraction of the capacity that is left")

    def get_value(self) -> EALData:
        """Return the charge as a share of the capacity."""
        message, stamp_s = self._reader.read()
        if not 0.0 <= message.percentage <= 1.0:
            raise DataError(
                f"the battery's percentage is {message.percentage:g}, not 0..1: the robot does not measure it"
            )
        return EALData.of(float(message.percentage), stamp_s=stamp_s)

    @request("voltage", ValueInfo(DataType.DOUBLE, "V"))
    def voltage(self) -> EALData:
        """Return the terminal voltage."""
        message, stamp_s = self._reader.read()
        return EALData.of(float(message.voltage), unit="V", stamp_s=stamp_s)

    @request("current", ValueInfo(DataType.DOUBLE, "A"))
    def current(self) -> EALData:
        """Return the charging current, negative while the battery is drained."""
        message, stamp_s = self._reader.read()
        return EALData.of(float(message.current), unit="A", stamp_s=stamp_s)


class TransformSensor(Resource):
    """The robot's tree of frames (tf); request `<target> <source>` for the pose of a frame in another one."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, description="JSON object: each frame's parent")

    def __init__(self, session: RosSession, subscriptions: list[RosSubscription]) -> None:
        self._session = session
        self._tree = TransformTree(subscriptions)
        self._first = subscriptions[0]

    @override
    def not_ready(self) -> str | None:
        self._tree.refresh()
        if self._tree.parents():
            return None
        absent = self._session.why_absent(graph.PUBLISHER, self._first.topic, self._first.kind)
        return absent or f"no message on {self._first.topic} yet"

    @override
    def background(self) -> Activity:
        while True:
            self._tree.refresh()
            yield _POLL_S

    def get_value(self) -> str:
        """Return each frame's parent."""
        self._tree.refresh()
        return json.dumps(self._tree.parents())

    @override
    def send_req(self, req: str) -> EALData:
        """Return x, y, z in m and the quaternion x, y, z, w of the source frame in the target frame.

        Raises:
            ArgumentError: the request is no two frames, or they are not connected.
        """
        self._tree.refresh()
        frames = req.split()
        if len(frames) != 2:
            raise ArgumentError(f"a request is two frames, such as `map base_link`, not {req!r}")
        return EALData.of(self._tree.lookup(frames[0], frames[1]), frame_id=frames[0])


class JsonTopic(TopicSensor):
    """A topic of any type, as a JSON object of its fields."""

    value = ValueInfo(DataType.CHAR, description="JSON object of the message's fields")

    def __init__(self, reader: TopicReader, subscription: RosSubscription) -> None:
        super().__init__(reader, subscription.kind.name)
        self._kind = subscription.kind

    def get_value(self) -> EALData:
        """Return the newest message."""
        message, stamp_s = self._reader.read()
        text = json.dumps(self._kind.to_dict(message), default=repr)
        if len(text) > _MOST_JSON:
            raise DataError(f"the message has {len(text)} characters as JSON; at most {_MOST_JSON} are given")
        return EALData.of(text, stamp_s=stamp_s)


class JsonPublisher(Resource):
    """A topic that is published: set_value with a JSON object of the message's fields."""

    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.CHAR, description="JSON object of the message's fields")

    def __init__(self, session: RosSession, publisher: RosPublisher) -> None:
        self._session = session
        self._publisher = publisher

    @override
    def not_ready(self) -> str | None:
        return self._session.why_not_ready()

    def set_value(self, data: EALData) -> None:
        """Publish a message; missing fields are zero or empty.

        Raises:
            ArgumentError: the text is no JSON object, or does not fit the type.
            UnavailableError: the router is out of reach.
        """
        self._publisher.publish(json_object(data.value, _FIELDS))

    @override
    def halt(self) -> None:
        """Do nothing: a topic does not move. What it moves has a resource or a watchdog of its own."""


class ServiceCaller(Resource):
    """A service: send_req with the request as JSON answers the response as JSON."""

    types = ResourceType.OTHER

    def __init__(self, session: RosSession, client: RosClient, timeout_s: float) -> None:
        self._session = session
        self._client = client
        self._timeout_s = timeout_s

    @override
    def not_ready(self) -> str | None:
        return self._session.why_absent(graph.SERVICE, self._client.name, self._client.kind)

    @override
    def send_req(self, req: str) -> Activity:
        """Call the service.

        Raises:
            ArgumentError: the text is no JSON object, or does not fit the type.
            UnavailableError: there is no answer in time.
            ResourceFaultError: the service answers with an error.
        """
        response = yield from self._client.call(json_object(req, _FIELDS), self._timeout_s)
        return json.dumps(self._client.kind.response.to_dict(response), default=repr)


_SENSORS: Final[dict[str, Callable[[TopicReader, str], TopicSensor]]] = {
    "sensor_msgs/msg/LaserScan": LaserScanSensor,
    "sensor_msgs/msg/Image": ImageSensor,
    "sensor_msgs/msg/CompressedImage": CompressedImageSensor,
    "sensor_msgs/msg/BatteryState": BatterySensor,
}
"""The sensor of each type; any other type is a JsonTopic."""


def sensor_for(reader: TopicReader, subscription: RosSubscription) -> Resource:
    """Return the resource of a topic that is read."""
    kind = subscription.kind.name
    make = _SENSORS.get(kind)
    return JsonTopic(reader, subscription) if make is None else make(reader, kind)


def default_timeout_s(settings: TopicSettings, kind: str) -> float | None:
    """Return the silence after which a topic is not ready: 2 s for typed sensors, which report all the time."""
    return settings.timeout_s if settings.timeout_s is not None or kind not in _SENSORS else 2.0
