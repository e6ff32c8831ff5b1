"""What a robot's actor is told of its robot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from eal_actors.actors.resource_factory import ResourceFactory
from eal_actors.actors.supervision import Restart
from eal_actors.device.link import Link
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import EALError


class OpenPlugins(Protocol):
    """A robot's connected plugins: what the plugin manager hands out."""

    @property
    def resources(self) -> Mapping[str, ResourceFactory]:
        """The factories by the resources' final names."""
        ...

    @property
    def errors(self) -> tuple[EALError, ...]:
        """What kept plugins out."""
        ...

    def close(self) -> None:
        """Disconnect every plugin."""
        ...


@dataclass(frozen=True, slots=True)
class RobotSpec:
    """What a robot actor needs to know of its robot.

    Attributes:
        name: the robot's name.
        clock: the fleet's clock.
        open_plugins: connects the robot's plugins; runs in the robot's thread and may take long.
        timeout_s: the default deadline of a call, and the time a resource may take to start.
        mailbox: the capacity of each mailbox.
        restart: when resources are restarted.
        max_restarts: restarts allowed within the window, for all resources together.
        restart_window_s: the window in seconds.
        link: what the calls to its resources pass on their way; a perfect one if None.
    """

    name: str
    clock: Clock
    open_plugins: Callable[[], OpenPlugins]
    timeout_s: float = 10.0
    mailbox: int = 256
    restart: Restart = Restart.PERMANENT
    max_restarts: int = 3
    restart_window_s: float = 5.0
    link: Link | None = None
