"""The other end: a ROS 2 robot made with zenoh-ros2-sdk, which others wrote, at a router of zenoh's own.

Its message definitions are written from rosbags beforehand; by itself it would clone them. It keeps one
session in a process, so one module of tests has one router.
"""

from __future__ import annotations

import json
import math
import os
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import zenoh
import zenoh_ros2_sdk
from rosbags.typesys import Stores, get_typestore
from zenoh_ros2_sdk import message_registry
from zenoh_ros2_sdk.session import ZenohSession

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME

SERVICES = {
    "std_srvs/srv/SetBool": "bool data\n---\nbool success\nstring message\n",
    "example_interfaces/srv/AddTwoInts": "int64 a\nint64 b\n---\nint64 sum\n",
}
PATIENCE_S = 60.0
"""Real seconds that a condition may take on a loaded machine."""


def write_definitions(folder: Path) -> None:
    """Write the definitions of rosbags as the SDK's registry reads them."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for name in store.fielddefs:
        package, kind, last = name.split("/")
        (folder / package / kind).mkdir(parents=True, exist_ok=True)
        text = store.generate_msgdef(name, ros_version=2)[0].split("=" * 80)[0]
        (folder / package / kind / f"{last}.msg").write_text(text)
    for name, text in SERVICES.items():
        package, kind, last = name.split("/")
        (folder / package / kind).mkdir(parents=True, exist_ok=True)
        (folder / package / kind / f"{last}.srv").write_text(text)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def open_router(port: int) -> zenoh.Session:
    settings = {
        "mode": "router",
        "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
        "scouting": {"multicast": {"enabled": False}},
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))


class Ros2Peer:
    """The SDK at a router: makes publishers, subscribers and services that end with its `with` block."""

    def __init__(self, folder: Path, port: int) -> None:
        self.port = port
        self.endpoint = f"tcp/127.0.0.1:{port}"
        self._stack = ExitStack()
        message_registry._registry = message_registry.MessageRegistry(str(folder))

    def __enter__(self) -> Ros2Peer:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _end(self, made: Any) -> Any:
        self._stack.callback(made.close)
        return made

    def publisher(self, topic: str, kind: str, **options: Any) -> Any:
        return self._end(zenoh_ros2_sdk.ROS2Publisher(topic, kind, router_port=self.port, **options))

    def subscriber(self, topic: str, kind: str, take: Callable[[Any], None], **options: Any) -> Any:
        return self._end(zenoh_ros2_sdk.ROS2Subscriber(topic, kind, take, router_port=self.port, **options))

    def server(self, service: str, kind: str, answer: Callable[[Any], Any]) -> Any:
        return self._end(zenoh_ros2_sdk.ROS2ServiceServer(service, kind, answer, router_port=self.port))

    def type(self, name: str) -> Any:
        return ZenohSession.get_instance(router_port=self.port).register_message_type(None, name)


@contextmanager
def ros2_peer(folder: Path) -> Iterator[Ros2Peer]:
    """Run a router and the SDK."""
    os.environ["ROS_DOMAIN_ID"] = "0"
    write_definitions(folder)
    port = free_port()
    router = open_router(port)
    with ExitStack() as stack:
        stack.callback(router.close)
        stack.callback(lambda: ZenohSession.get_instance(router_port=port).close())
        yield Ros2Peer(folder, port)


class SdkRobot:
    """A differential robot: follows cmd_vel with a watchdog of half a second, publishes its odometry at 50 Hz.

    Its motion is exact: the true path is its own.
    """

    def __init__(self, peer: Ros2Peer, namespace: str) -> None:
        self._types = {
            name: peer.type(name)
            for name in (
                "std_msgs/msg/Header",
                "builtin_interfaces/msg/Time",
                "geometry_msgs/msg/PoseWithCovariance",
                "geometry_msgs/msg/TwistWithCovariance",
                "geometry_msgs/msg/Pose",
                "geometry_msgs/msg/Point",
                "geometry_msgs/msg/Quaternion",
                "geometry_msgs/msg/Twist",
                "geometry_msgs/msg/Vector3",
            )
        }
        self._odometry = peer.publisher(f"{namespace}/odom", "nav_msgs/msg/Odometry", namespace=namespace)
        self._lock = threading.Lock()
        self.pose = (0.0, 0.0, 0.0)
        self.turned_rad = 0.0
        self.twist = (0.0, 0.0)
        self.commands: list[tuple[float, float]] = []
        self.is_silent = False
        self._commanded_s = -math.inf
        self._end = threading.Event()
        peer.subscriber(f"{namespace}/cmd_vel", "geometry_msgs/msg/Twist", self._take, namespace=namespace)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> SdkRobot:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _take(self, message: Any) -> None:
        with self._lock:
            self.twist = message.linear.x, message.angular.z
            self.commands.append(self.twist)
            self._commanded_s = REAL_TIME.now()

    def _run(self) -> None:
        before_s = REAL_TIME.now()
        while not self._end.wait(0.02):
            now_s = REAL_TIME.now()
            with self._lock:
                if now_s - self._commanded_s > 0.5:
                    self.twist = 0.0, 0.0
                self._move(min(now_s - before_s, 0.1))
            before_s = now_s
            if not self.is_silent:
                self.publish(*self.pose)

    def _move(self, dt_s: float) -> None:
        (x_m, y_m, yaw_rad), (speed, rate) = self.pose, self.twist
        self.turned_rad += rate * dt_s
        self.pose = (
            x_m + speed * math.cos(yaw_rad + rate * dt_s / 2) * dt_s,
            y_m + speed * math.sin(yaw_rad + rate * dt_s / 2) * dt_s,
            yaw_rad + rate * dt_s,
        )

    def publish(self, x_m: float, y_m: float, yaw_rad: float, norm: float = 1.0) -> None:
        """Publish odometry; with another norm than 1, its quaternion is no rotation."""
        import numpy as np

        make = {name.rpartition("/")[2]: kind for name, kind in self._types.items()}
        sec, nanosec = divmod(int(REAL_TIME.now() * 1e9), 10**9)
        zero = np.zeros(36)
        vector = make["Vector3"]
        self._odometry.publish(
            header=make["Header"](stamp=make["Time"](sec=sec, nanosec=nanosec), frame_id="odom"),
            child_frame_id="base_link",
            pose=make["PoseWithCovariance"](
                pose=make["Pose"](
                    position=make["Point"](x=x_m, y=y_m, z=0.0),
                    orientation=make["Quaternion"](
                        x=0.0, y=0.0, z=norm * math.sin(yaw_rad / 2), w=norm * math.cos(yaw_rad / 2)
                    ),
                ),
                covariance=zero,
            ),
            twist=make["TwistWithCovariance"](
                twist=make["Twist"](
                    linear=vector(x=self.twist[0], y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=self.twist[1])
                ),
                covariance=zero,
            ),
        )


def ros2_fleet(folder: Path, peer: Ros2Peer | str, **robots: dict[str, Any]) -> Fleet:
    """Return a fleet of ROS 2 robots, from a file."""
    router = peer if isinstance(peer, str) else peer.endpoint
    content = {
        "version": 1,
        "name": "ros",
        "robots": {name: {"plugins": {"ros2": {"router": router, **settings}}} for name, settings in robots.items()},
    }
    file = folder / "ros.yaml"
    file.write_text(json.dumps(content))
    return Fleet.load(file)


def wait_for(condition: Callable[[], bool], what: str) -> None:
    """Wait for a condition, at most PATIENCE_S."""
    end_s = REAL_TIME.now() + PATIENCE_S
    while not condition():
        assert REAL_TIME.now() < end_s, what
        REAL_TIME.sleep(0.01)
