"""The ros2 plugin: a robot of the ROS 2 graph, over zenoh as rmw_zenoh maps it; no ROS is needed here."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from eal_actors.plugin import (
    EALError,
    FactoryPlugin,
    OdometryNoise,
    PluginContext,
    PluginError,
    PoseResource,
    Resource,
)

from .base import Base
from .message_types import MessageTypes
from .navigation import Navigator
from .odometry import Odometry, RosOdometer
from .resources import JsonPublisher, ServiceCaller, TopicReader, TransformSensor, default_timeout_s, sensor_for
from .session import RosNode, RosSession
from .settings import DriveSettings, ServiceSettings, Settings, TopicSettings

__all__ = ["Settings"]

_TF = "tf2_msgs/msg/TFMessage"
_ODOMETRY_DEPTH = 100
_TF_DEPTH = 200
_FIRST_S = 1.5
"""Longest wait of `connect` for the first odometry, in real seconds: the first call after it is to be answered."""


class Ros2Plugin(FactoryPlugin):
    """One robot's session in the graph."""

    def __init__(self, session: RosSession, makers: dict[str, Callable[[], Resource]]) -> None:
        super().__init__(makers)
        self.session = session


def connect(context: PluginContext) -> Ros2Plugin:
    """Open the session; an absent router or robot is not ready, and reached when it appears.

    Raises:
        PluginError: the settings name no resource or one twice, a type is unknown, or a definition is wrong.

    Thread: the robot's; blocks at most two seconds.
    """
    settings: Settings = context.settings
    if settings.drive is None and not settings.topics and not settings.services:
        raise PluginError("ros2 needs `drive`, `topics` or `services`")
    types = _types(context, settings)
    session = RosSession(settings.router, settings.domain, settings.zenoh_config)
    try:
        node = session.node(settings.namespace, f"eal_{context.robot}".replace("-", "_"))
        makers: dict[str, Callable[[], Resource]] = {}
        if settings.drive is not None:
            makers |= _drive(context, session, node, types, settings.drive)
        for name, topic in settings.topics.items():
            _add(makers, name, _topic(context, session, node, types, topic))
        for name, service in settings.services.items():
            _add(makers, name, _service(session, node, types, service))
        plugin = Ros2Plugin(session, makers)
        _wait_for_odometry(context, session)
        return plugin
    except BaseException:
        session.close()
        raise


def _wait_for_odometry(context: PluginContext, session: RosSession) -> None:
    """Wait for the first odometry of a driven robot whose router is there."""
    end_s, pause = time.perf_counter() + _FIRST_S, threading.Event()
    while context.settings.drive is not None and session.why_not_ready() is None and time.perf_counter() < end_s:
        try:
            context.localizer.estimate(context.clock.now())
        except EALError:
            pause.wait(0.02)
        else:
            return


def _types(context: PluginContext, settings: Settings) -> MessageTypes:
    folder = None if settings.messages is None else Path(settings.messages)
    key = "ros2 types", settings.distribution, settings.messages
    return context.services.shared(key, lambda: MessageTypes(settings.distribution, folder))


def _add(makers: dict[str, Callable[[], Resource]], name: str, make: Callable[[], Resource]) -> None:
    if name in makers:
        raise PluginError(f"two resources are named {name!r}")
    makers[name] = make


def _drive(
    context: PluginContext, session: RosSession, node: RosNode, types: MessageTypes, settings: DriveSettings
) -> dict[str, Callable[[], Resource]]:
    drivetrain = settings.drivetrain("ros2", settings.track_m, settings.acceleration_m_s2)
    twist = types.message("geometry_msgs/msg/TwistStamped" if settings.stamped else "geometry_msgs/msg/Twist")
    publisher = node.publisher(settings.cmd_vel, twist)
    odometer = RosOdometer(
        session,
        node.subscription(settings.odometry, types.message("nav_msgs/msg/Odometry"), depth=_ODOMETRY_DEPTH),
        context.clock,
        context.localizer,
        OdometryNoise(settings.track_m),
        settings.odometry_timeout_s,
    )
    navigator = None if settings.navigate is None else Navigator(node, types, settings.navigate, context.clock)
    return {
        "Base": partial(Base, drivetrain, context, publisher, odometer, navigator, stamped=settings.stamped),
        "Odometry": partial(Odometry, odometer),
        "Pose": partial(PoseResource, context.localizer, context.clock),
    }


def _topic(
    context: PluginContext, session: RosSession, node: RosNode, types: MessageTypes, settings: TopicSettings
) -> Callable[[], Resource]:
    kind = types.message(settings.type)
    if settings.writable:
        return partial(JsonPublisher, session, node.publisher(settings.topic, kind))
    if kind.name == _TF:
        subscriptions = [
            node.subscription(topic, kind, depth=_TF_DEPTH, transient_local=static, max_bytes=settings.max_bytes)
            for topic, static in ((settings.topic, False), (f"{settings.topic}_static", True))
        ]
        return partial(TransformSensor, session, subscriptions)
    subscription = node.subscription(
        settings.topic, kind, transient_local=settings.latched, max_bytes=settings.max_bytes
    )
    reader = TopicReader(session, subscription, context.clock, default_timeout_s(settings, kind.name))
    return partial(sensor_for, reader, subscription)


def _service(
    session: RosSession, node: RosNode, types: MessageTypes, settings: ServiceSettings
) -> Callable[[], Resource]:
    return partial(
        ServiceCaller, session, node.client(settings.service, types.service(settings.type)), settings.timeout_s
    )


def disconnect(plugin: Ros2Plugin) -> None:
    """Close the session."""
    plugin.session.close()
