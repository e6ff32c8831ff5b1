"""FleetTopics: the values of resources as ROS 2 messages.

A kind of value is one function here: it decides by the resource's information, and fills a message.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

from eal_actors import EALData, EALError, ResourceHandle
from eal_actors.plugin import Clock, DataType, ResourceInfo, get_logger, wrapped_rad

from .endpoints import RosPublisher
from .message_types import MessageTypes
from .session import RosNode

Fields = dict[str, Any]
Pose = tuple[float, float, float]
_POSE_SHAPE: Final = (3,)
_ANGLES_S: Final = 5.0
_MOST_RANGE: Final = "max_range_m"
_PAUSE_S: Final = 1.0
"""Between two poses of an odometry that give no velocity."""


class FleetTopics:
    """Publishes values of resources; see `bridge`. Thread: the values of a resource in one, `add` of it before."""

    def __init__(self, types: MessageTypes, clock: Clock) -> None:
        self._types = types
        self._clock = clock
        self._publishers: dict[tuple[str, str], tuple[RosPublisher, Callable[[EALData, Fields], Fields]]] = {}
        self._transforms: dict[str, RosPublisher] = {}
        self._odometry: dict[str, Pose] = {}
        self._topics: dict[tuple[str, str], str] = {}
        self._plans: dict[str, RosPublisher] = {}

    def add(self, node: RosNode, resource: ResourceHandle) -> bool:
        """Publish a resource; returns False if its values are no message."""
        found = self._choose(node, resource)
        if found is None:
            return False
        topic, kind, fill = found
        publisher = node.publisher(topic, self._types.message(kind))
        self._publishers[resource.robot, resource.name] = publisher, fill
        self._topics[resource.robot, resource.name] = node.full_name(topic)
        if resource.name in ("Odometry", "Pose") and resource.robot not in self._transforms:
            self._transforms[resource.robot] = node.publisher("/tf", self._types.message("tf2_msgs/msg/TFMessage"))
        return True

    def add_plan(self, node: RosNode, robot: str) -> str:
        """Publish the paths of a robot's motions; returns the fully qualified topic."""
        self._plans[robot] = node.publisher("plan", self._types.message("nav_msgs/msg/Path"))
        return node.full_name("plan")

    @property
    def count(self) -> int:
        """The number of published resources and paths."""
        return len(self._publishers) + len(self._plans)

    def topic_of(self, resource: ResourceHandle) -> str:
        """Return the fully qualified topic of a resource that was added."""
        return self._topics[resource.robot, resource.name]

    def publish(self, resource: ResourceHandle, data: EALData) -> bool:
        """Publish a value; a sink of a Sampler."""
        publisher, fill = self._publishers[resource.robot, resource.name]
        age_s = 0.0 if data.stamp_s is None else max(0.0, self._clock.now() - data.stamp_s)
        stamp = _stamp(age_s)
        try:
            publisher.publish(fill(data, stamp))
            self._publish_transform(resource, data, stamp)
        except EALError as error:  # the router is gone, or a value is none
            get_logger(robot=resource.robot).debug("not published", resource=resource.name, reason=error.message)
        return True

    def publish_plan(self, robot: str, path: EALData) -> None:
        """Publish the path of a robot's motion, as Base answers it; without poses while it has none."""
        header = {"stamp": _stamp(0.0), "frame_id": "map"}
        numbers = map(float, path.value)
        poses = [{"header": header, "pose": _pose(pose)} for pose in zip(numbers, numbers, numbers, strict=True)]
        try:
            self._plans[robot].publish({"header": header, "poses": poses})
        except EALError as error:  # the router is gone
            get_logger(robot=robot).debug("its path is not published", reason=error.message)

    def _choose(
        self, node: RosNode, resource: ResourceHandle
    ) -> tuple[str, str, Callable[[EALData, Fields], Fields]] | None:
        """Return the topic, the message type and the function that fills it."""
        info, name, prefix = resource.info, resource.name, node.namespace.strip("/")
        value = info.value
        topic = name.replace(".", "_").lower()
        if value is None or "get_value" not in info.methods:
            return None
        if value.shape == _POSE_SHAPE and name in ("Odometry", "Pose"):
            frame, topic = (f"{prefix}/odom", "odom") if name == "Odometry" else ("map", "pose")
            return (topic, *_pose_message(name, frame, f"{prefix}/base_link"))
        if info.is_camera:
            return f"{topic}/image_raw", "sensor_msgs/msg/Image", _image(f"{prefix}/{topic}")
        if _is_scan(info):
            topic = "scan" if name == "Lidar" else topic
            return topic, "sensor_msgs/msg/LaserScan", _scan(resource, f"{prefix}/base_link")
        if name == "Battery" and (value.minimum, value.maximum) == (0, 1):
            return "battery_state", "sensor_msgs/msg/BatteryState", _battery
        basic = None if value.shape else _BASIC.get(value.type)
        return None if basic is None else (topic, *basic)

    def _publish_transform(self, resource: ResourceHandle, data: EALData, stamp: Fields) -> None:
        """Publish odom to base_link, and map to odom such that base_link is at the estimated pose."""
        robot, publisher = resource.robot, self._transforms.get(resource.robot)
        if publisher is None or resource.name not in ("Odometry", "Pose"):
            return
        x_m, y_m, yaw_rad = map(float, data.value)
        prefix = ros_name(robot)
        if resource.name == "Odometry":
            self._odometry[robot] = x_m, y_m, yaw_rad
            frames, pose = (f"{prefix}/odom", f"{prefix}/base_link"), (x_m, y_m, yaw_rad)
        elif robot in self._odometry:
            frames, pose = ("map", f"{prefix}/odom"), _difference((x_m, y_m, yaw_rad), self._odometry[robot])
        else:
            frames, pose = ("map", f"{prefix}/base_link"), (x_m, y_m, yaw_rad)
        position, orientation = _position(pose)
        transform = {"translation": position, "rotation": orientation}
        header = {"stamp": stamp, "frame_id": frames[0]}
        publisher.publish({"transforms": [{"header": header, "child_frame_id": frames[1], "transform": transform}]})


def ros_name(name: str) -> str:
    """Return a robot's name as ROS 2 allows it, `evbot2_1` for `evbot2-1`."""
    found = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in name)
    return found if found[:1].isalpha() else f"r_{found}"


def _stamp(age_s: float) -> Fields:
    """Return the wall-clock time of that many seconds ago."""
    sec, nanosec = divmod(time.time_ns() - int(age_s * 1e9), 10**9)
    return {"sec": sec, "nanosec": nanosec}


def _is_scan(info: ResourceInfo) -> bool:
    """Return whether values are distances along rays, whose angles can be asked."""
    value = info.value
    is_row = value is not None and value.unit == "m" and len(value.shape) == 1
    return is_row and any(request.name == "angles" for request in info.requests)


def _difference(pose: Pose, odometry: Pose) -> Pose:
    """Return the pose of the odometry's frame in the map."""
    turn_rad = pose[2] - odometry[2]
    cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
    return (
        pose[0] - cosine * odometry[0] + sine * odometry[1],
        pose[1] - sine * odometry[0] - cosine * odometry[1],
        turn_rad,
    )


def _position(pose: Pose) -> tuple[Fields, Fields]:
    x_m, y_m, yaw_rad = pose
    return {"x": x_m, "y": y_m}, {"z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2)}


def _pose(pose: Pose) -> Fields:
    position, orientation = _position(pose)
    return {"position": position, "orientation": orientation}


def _pose_message(name: str, frame: str, child: str) -> tuple[str, Callable[[EALData, Fields], Fields]]:
    velocity = _Velocity()

    def fill(data: EALData, stamp: Fields) -> Fields:
        x_m, y_m, yaw_rad = map(float, data.value)
        pose = _pose((x_m, y_m, yaw_rad))
        header = {"stamp": stamp, "frame_id": frame}
        if name == "Odometry":
            twist = velocity.after((x_m, y_m, yaw_rad), data.stamp_s)
            return {"header": header, "child_frame_id": child, "pose": {"pose": pose}, "twist": {"twist": twist}}
        return {"header": header, "pose": pose}

    return ("nav_msgs/msg/Odometry" if name == "Odometry" else "geometry_msgs/msg/PoseStamped"), fill


class _Velocity:
    """The velocity of an odometry, by its last two poses; in the robot's frame."""

    def __init__(self) -> None:
        self._last: tuple[Pose, float] | None = None
        self._twist: Fields = {}

    def after(self, pose: Pose, stamp_s: float | None) -> Fields:
        """Return the twist for one more pose; a pose of the same time leaves it."""
        if stamp_s is None:
            return self._twist
        (before, before_s), self._last = self._last or (pose, stamp_s), (pose, stamp_s)
        if not 0.0 < (passed_s := stamp_s - before_s) < _PAUSE_S:
            self._twist = self._twist if passed_s == 0.0 else {}
            return self._twist
        turn_rad = wrapped_rad(pose[2] - before[2])
        middle_rad = before[2] + turn_rad / 2
        gone = pose[0] - before[0], pose[1] - before[1]
        ahead_m = gone[0] * math.cos(middle_rad) + gone[1] * math.sin(middle_rad)
        self._twist = {"linear": {"x": ahead_m / passed_s}, "angular": {"z": turn_rad / passed_s}}
        return self._twist


def _image(frame: str) -> Callable[[EALData, Fields], Fields]:
    def fill(data: EALData, stamp: Fields) -> Fields:
        picture = data.value
        height, width = picture.shape[:2]
        header = {"stamp": stamp, "frame_id": frame}
        size = {"height": height, "width": width, "step": 3 * width}
        return {"header": header, **size, "encoding": "rgb8", "data": picture.tobytes()}

    return fill


def _scan(resource: ResourceHandle, frame: str) -> Callable[[EALData, Fields], Fields]:
    """Return the function that fills a scan; its angles are asked once, and must be evenly spaced.

    A ray that hits nothing is infinite (Source: REP 117), if the scanner tells its greatest range.
    """
    angles = resource.send_req("angles", timeout_s=_ANGLES_S)
    tells_most = any(config.name == _MOST_RANGE for config in resource.info.configs)
    most = resource.get_config(_MOST_RANGE, timeout_s=_ANGLES_S) if tells_most else None

    def fill(data: EALData, stamp: Fields) -> Fields:
        rays = [float(angle) for angle in angles.get().value]
        step = (rays[-1] - rays[0]) / max(1, len(rays) - 1)
        ranges = list(map(float, data.value))
        most_m = max(ranges) if most is None else float(most.get().value)
        if most is not None:
            ranges = [range_m if range_m < most_m else math.inf for range_m in ranges]
        return {
            "header": {"stamp": stamp, "frame_id": frame},
            "angle_min": rays[0],
            "angle_max": rays[-1],
            "angle_increment": step,
            "range_min": 0.0,
            "range_max": most_m,
            "ranges": ranges,
        }

    return fill


def _battery(data: EALData, stamp: Fields) -> Fields:
    unknown = dict.fromkeys(("voltage", "temperature", "current", "charge", "capacity", "design_capacity"), math.nan)
    return {"header": {"stamp": stamp}, **unknown, "percentage": float(data.value), "present": True}


def _data(data: EALData, _: Fields) -> Fields:
    return {"data": data.value}


_BASIC: Final[Mapping[DataType, tuple[str, Callable[[EALData, Fields], Fields]]]] = {
    DataType.DOUBLE: ("std_msgs/msg/Float64", _data),
    DataType.FLOAT: ("std_msgs/msg/Float32", _data),
    DataType.INT: ("std_msgs/msg/Int64", _data),
    DataType.BOOL: ("std_msgs/msg/Bool", _data),
    DataType.CHAR: ("std_msgs/msg/String", _data),
}
"""The message of each type of single values."""
