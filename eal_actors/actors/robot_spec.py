"""The specification of a robot for its actor, and the plugins that it opens."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from eal_actors.actors.supervision import Restart
from eal_actors.device.link import FaultyLink
from eal_actors.device.resource import Resource
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError


class ResourceFactory(Protocol):
    """Makes and destroys one resource; the plugin manager provides it. Thread: the resource's actor."""

    def create(self) -> Resource:
        """Return a new resource."""
        ...

    def destroy(self, resource: Resource) -> None:
        """Destroy the resource."""
        ...


class OpenPlugins(Protocol):
    """A robot's connected plugins; the plugin manager provides them."""

    @property
    def resources(self) -> Mapping[str, ResourceFactory]:
        """The factories by the resources' final names."""
        ...

    @property
    def errors(self) -> tuple[EALError, ...]:
        """The errors of plugins that did not connect."""
        ...

    def close(self) -> None:
        """Disconnect every plugin."""
        ...


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """The specification of a robot.

    Attributes:
        name: the robot's name.
        clock: the fleet's clock.
        open_plugins: connects the robot's plugins; runs in the robot's thread and may take long.
        timeout_s: the default deadline of a call, and the time a resource may take to start.
        mailbox: the capacity of each mailbox.
        restart: when resources are restarted.
        max_restarts: restarts allowed within the window, for all resources together.
        restart_window_s: the window in seconds.
        link: the link that calls to its resources pass; a faultless one if None.
    """

    name: str
    clock: Clock
    open_plugins: Callable[[], OpenPlugins]
    timeout_s: float = 10.0
    mailbox: int = 256
    restart: Restart = Restart.PERMANENT
    max_restarts: int = 3
    restart_window_s: float = 5.0
    link: FaultyLink | None = None
