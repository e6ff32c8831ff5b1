"""The fleet as ROS 2 nodes: each robot publishes its sensors as standard topics, and is driven by `cmd_vel`.

Robot `evbot2-1` becomes the node `/evbot2_1/eal`, with `/evbot2_1/odom`, `/evbot2_1/cmd_vel` and so on, and its frames
in `/tf`: map, evbot2_1/odom, evbot2_1/base_link.

A velocity is a value of the robot's Base, under its lease; so a robot that another controller holds does not move.
Velocities that cease halt the robot, and the lease is released.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, Final

from eal_actors import EALData, EALError, Fleet, Future, RobotHandle
from eal_actors.facade.latecomers import Latecomers
from eal_actors.plugin import DataError, Field, LogLimit, PluginError, get_logger
from eal_actors.recording.sampler import Sampler, SampleSpec

from . import graph
from .endpoints import RosSubscription
from .message_types import MessageTypes
from .outgoing import FleetTopics, ros_name
from .session import RosSession
from .settings import GraphSettings

_BASE: Final = "Base"
_TICK_S: Final = 0.02
_SILENCE_S: Final = 0.5
"""Real seconds without a velocity after which a robot is halted and released."""
_PLAN_S: Final = 0.5
"""Real seconds between two messages of a motion's path."""
_PICTURE_S: Final = 30.0
"""Deadline of a picture: the first one of a simulated camera takes seconds on a busy machine."""


class BridgeSettings(GraphSettings):
    """The settings of `eal bridge ros2`."""

    rate_hz: float = Field(default=10.0, gt=0, le=100)
    """Messages of each sensor in a second."""
    camera_rate_hz: float = Field(default=2.0, gt=0, le=30)
    """Pictures of each camera in a second."""
    drive: bool = True
    """Whether robots follow `cmd_vel`."""
    stamped: bool = False
    """Whether `cmd_vel` is a TwistStamped, as Nav2 of Kilted and later publishes; else a Twist."""


@contextmanager
def open_bridge(fleet: Fleet, settings: BridgeSettings) -> Iterator[str]:
    """Connect an open fleet; yields what it does, for people.

    Raises:
        PluginError: zenoh's configuration is wrong, or two robots would be one node.
    """
    _check_names(fleet)
    latecomers = Latecomers(fleet)
    session = RosSession(settings.router, settings.domain, settings.zenoh_config)
    with ExitStack() as stack:
        stack.callback(session.close)
        nodes = _Nodes(fleet, settings, session, stack)
        nodes.add(latecomers.present)
        with _stepping(nodes.steps, partial(latecomers.take_in, nodes.add)):
            where = f"domain {settings.domain} at {settings.router}"
            absent = session.why_not_ready()
            count = len(latecomers.present)
            yield f"{count} nodes, {nodes.topics.count} topics in {where}" + (f"; {absent}" if absent else "")


class _Nodes:
    """The robots as nodes; `stack` ends the sampling.

    Attributes:
        topics: of all robots.
        steps: what the bridge's thread does, repeatedly.
    """

    def __init__(self, fleet: Fleet, settings: BridgeSettings, session: RosSession, stack: ExitStack) -> None:
        self._clock = fleet.clock
        self._settings = settings
        self._session = session
        self._stack = stack
        self._types = MessageTypes(settings.distribution)
        self.topics: Final = FleetTopics(self._types, fleet.clock)
        self.steps: Final[list[SubscribedFeed | VelocityFollower]] = []

    def add(self, robots: Sequence[RobotHandle]) -> None:
        """Make nodes of robots. Thread: the bridge's, or before it."""
        specs = [spec for robot in robots for spec in self._make_node(robot)]
        self._stack.enter_context(Sampler(self._clock, specs, self.topics.publish))

    def _make_node(self, robot: RobotHandle) -> Iterator[SampleSpec]:
        node, topics = self._session.node(ros_name(robot.name), "eal"), self.topics
        for resource in robot.values():
            if not topics.add(node, resource):
                continue
            if resource.info.is_camera:
                topic, ask = topics.topic_of(resource), partial(resource.get_value, timeout_s=_PICTURE_S)
                self._feed(topic, 1.0 / self._settings.camera_rate_hz, ask, partial(topics.publish, resource))
            else:
                yield SampleSpec(resource, 1.0 / self._settings.rate_hz)
        if _tells_path(robot):
            topic, ask = topics.add_plan(node, robot.name), partial(robot[_BASE].send_req, "path")
            self._feed(topic, _PLAN_S, ask, partial(topics.publish_plan, robot.name))
        if self._settings.drive and _takes_twist(robot):
            twist = self._types.message(f"geometry_msgs/msg/Twist{'Stamped' if self._settings.stamped else ''}")
            self.steps.append(VelocityFollower(robot, node.subscription("cmd_vel", twist)))

    def _feed(
        self, topic: str, period_s: float, ask: Callable[[], Future[EALData]], publish: Callable[[EALData], object]
    ) -> None:
        self.steps.append(SubscribedFeed(self._session, topic, period_s, ask, publish))


def _check_names(fleet: Fleet) -> None:
    owners: dict[str, str] = {}
    for robot in fleet:
        if (owner := owners.setdefault(ros_name(robot), robot)) != robot:
            raise PluginError(f"{owner} and {robot} would both be the node /{ros_name(robot)}: rename one of them")


def _takes_twist(robot: RobotHandle) -> bool:
    if _BASE not in robot:
        return False
    info = robot[_BASE].info
    return "set_value" in info.methods and info.value is not None and info.value.shape == (2,)


def _tells_path(robot: RobotHandle) -> bool:
    return _BASE in robot and any(request.name == "path" for request in robot[_BASE].info.requests)


@contextmanager
def _stepping(steps: Sequence[SubscribedFeed | VelocityFollower], take_in: Callable[[], None]) -> Iterator[None]:
    """Step followers and feeds in a thread, which `take_in` may add to; at the end every driven robot is halted."""
    end = threading.Event()
    logged: set[SubscribedFeed | VelocityFollower] = set()

    def run() -> None:
        while not end.wait(_TICK_S):
            take_in()
            for one in steps:
                try:
                    one.step()
                except Exception as error:  # noqa: BLE001  # as above
                    if one not in logged:
                        logged.add(one)
                        get_logger().error("a topic is not served", error=f"{type(error).__name__}: {error}")

    thread = threading.Thread(target=run, name="ros2 velocities", daemon=True)
    thread.start()
    try:
        yield
    finally:
        end.set()
        thread.join()
        for one in steps:
            one.let_go()


class SubscribedFeed:
    """Publishes what costs much to ask for, while somebody subscribes to its topic. Thread: one at a time.

    Args:
        topic: fully qualified.
        period_s: real seconds from one message to the next.
    """

    def __init__(
        self,
        session: RosSession,
        topic: str,
        period_s: float,
        ask: Callable[[], Future[EALData]],
        publish: Callable[[EALData], object],
    ) -> None:
        self._session = session
        self._topic = topic
        self._period_s = period_s
        self._ask = ask
        self._publish = publish
        self._due_s = 0.0
        self._answer: Future[EALData] | None = None

    def step(self) -> None:
        """Publish content that has arrived, or ask for the next one."""
        if self._answer is not None:
            if self._answer.done():
                answer, self._answer = self._answer, None
                if answer.exception() is None:
                    self._publish(answer.get())
        elif time.perf_counter() >= self._due_s and self._session.entities(graph.SUBSCRIPTION, self._topic):
            self._due_s = time.perf_counter() + self._period_s
            self._answer = self._ask()

    def let_go(self) -> None:
        """Do nothing: a feed moves nothing."""


class VelocityFollower:
    """Drives one robot by its `cmd_vel`. Thread: one at a time."""

    def __init__(self, robot: RobotHandle, subscription: RosSubscription) -> None:
        self._robot = robot
        self._subscription = subscription
        self._commanded_s: float | None = None
        self._log = get_logger(robot=robot.name)
        self._ignored = LogLimit(most=1)

    def step(self) -> None:
        """Follow the newest velocity, or halt the robot when they cease."""
        now_s = time.perf_counter()
        try:
            if (received := self._subscription.take()) is not None:
                self._drive(getattr(received.message, "twist", received.message), now_s)
        except EALError as error:  # broken bytes, or a robot that is lost
            self._warn(error.message)
        if self._commanded_s is not None and now_s - self._commanded_s > _SILENCE_S:
            self.let_go()

    def _drive(self, message: Any, now_s: float) -> None:
        twist = float(message.linear.x), float(message.angular.z)
        if not all(map(math.isfinite, twist)):
            raise DataError(f"a velocity of {twist[0]:g} m/s and {twist[1]:g} rad/s is ignored")
        answer = self._robot[_BASE].set_value(list(twist))
        self._commanded_s = now_s  # before the answer, which may take it back
        answer.add_done_callback(self._on_answer)

    def _on_answer(self, answer: Future[int]) -> None:
        error = answer.exception()
        if not isinstance(error, EALError) or error.code == "preempted":  # preempted by the next velocity
            return
        if error.code == "resource_busy":  # it moves for its holder, whom a halt would stop
            self._commanded_s = None
        self._warn(error.message)

    def let_go(self) -> None:
        """Halt the robot if it is driven, and release its lease."""
        if self._commanded_s is None:
            return
        self._commanded_s = None
        try:
            self._robot[_BASE].halt()
            self._robot.release(_BASE)
        except EALError as error:
            self._log.error("could not be halted after its velocities ceased", reason=error.message)

    def _warn(self, reason: str) -> None:
        if (more := self._ignored.admit()) is not None:
            self._log.warning("a velocity of cmd_vel is not followed", reason=reason, **more)
