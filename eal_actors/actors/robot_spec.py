"""The specification of a robot for its actor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from eal_actors.actors.supervision import Restart
from eal_actors.device.link import FaultyLink
from eal_actors.device.plugin_context import OpenPlugins
from eal_actors.kernel.clock import Clock


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
