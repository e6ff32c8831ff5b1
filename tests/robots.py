"""Robots defined in a test: real actors around resources written beside the assertions."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_actor import RobotSpec, start_robot
from eal_actors.device.plugin_context import OpenPlugins, ResourceFactory
from eal_actors.device.resource import Resource
from eal_actors.kernel.clock import Clock, SystemClock
from eal_actors.kernel.errors import EALError
from tests.manual_clock import ManualClock

WAIT_S = 10.0
"""Real seconds after which a test that waits for something gives up."""


@dataclass
class InlineFactory(ResourceFactory):
    """A factory of resources without a plugin around it."""

    make: Callable[[], Resource]
    destroyed: list[Resource] = field(default_factory=list)

    def create(self) -> Resource:
        return self.make()

    def destroy(self, resource: Resource) -> None:
        self.destroyed.append(resource)


@dataclass
class InlinePlugins(OpenPlugins):
    """Connected plugins without a folder around them."""

    resources: Mapping[str, InlineFactory]
    errors: tuple[EALError, ...] = ()
    closed: threading.Event = field(default_factory=threading.Event)

    def close(self) -> None:
        self.closed.set()


@contextmanager
def running_robot(
    resources: Mapping[str, Callable[[], Resource]],
    *,
    name: str = "robot",
    clock: Clock | None = None,
    close_timeout_s: float = 5.0,
    wait: bool = True,
    **spec: Any,
) -> Iterator[RobotHandle]:
    """Start a robot with the given resources; close it at the end."""
    plugins = InlinePlugins({name: InlineFactory(make) for name, make in resources.items()})
    robot_spec = RobotSpec(name, clock or SystemClock(), lambda: plugins, **spec)
    robot = RobotHandle(partial(start_robot, robot_spec), name)
    try:
        if wait:
            robot.wait_started(WAIT_S)
        yield robot
    finally:
        robot.close(close_timeout_s)


def advance_until_done(clock: ManualClock, future: Future[Any], step_s: float = 0.02, most_s: float = 60.0) -> None:
    """Advance the clock until the future is done; each step gives the actors time to react."""
    settled = threading.Event()
    future.add_done_callback(lambda _: settled.set())
    advanced_s = 0.0
    while not settled.wait(0.002):
        assert advanced_s < most_s, f"{future!r} is not done after {most_s} s"
        clock.advance(step_s)
        advanced_s += step_s
