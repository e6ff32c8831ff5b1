"""The sim plugin: one robot of the world that all simulated robots of a fleet share."""

from __future__ import annotations

import math

from eal_actors.plugin import EALPlugin, Field, PluginContext, PluginSettingsModel, Resource

from .models import MAKES, MakeName
from .resources import Base, Bump, Camera, Pose, Range
from .robot import SimRobot
from .world import SimWorld


class Start(PluginSettingsModel):
    """Where the robot stands at first, in the world's frame: the origin in the middle, x right, y up."""

    x_m: float
    y_m: float
    yaw_deg: float = Field(default=0.0, ge=-360, le=360)


class Settings(PluginSettingsModel):
    """What the fleet file may set."""

    model: MakeName
    """The make of the robot."""
    start: Start | None = None
    """Without it the robot gets a free place, facing along x; places are given in the order of the robots' names."""
    noise: bool = True
    """Whether the wheels have the make's errors."""


class SimPlugin(EALPlugin):
    """A robot in the fleet's simulated world."""

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__("Base", "Pose", "Bump", "Range", "Camera")
        self.world = world
        self.robot = robot


def connect(context: PluginContext) -> SimPlugin:
    """Put the robot into the world.

    Raises:
        PluginError: its start is not free, or it is there already with other settings.
    """
    services, settings = context.services, context.settings
    world = services.shared("sim.world", lambda: SimWorld(services.clock, services.seed, services.world))
    at = settings.start
    start = (float(at.x_m), float(at.y_m), math.radians(at.yaw_deg)) if at else None
    robot = world.join(context.robot, MAKES[settings.model], noise=settings.noise, start=start)
    return SimPlugin(world, robot)


def disconnect(plugin: SimPlugin) -> None:
    """Stop the robot; it stays where it stands."""
    with plugin.world.caught_up():
        plugin.world.stop(plugin.robot)


def create_Base(context: PluginContext) -> Base:  # noqa: N802
    """Make the resource."""
    return Base(context.plugin.world, context.plugin.robot)


def create_Pose(context: PluginContext) -> Pose:  # noqa: N802
    """Make the resource."""
    return Pose(context.plugin.world, context.plugin.robot)


def create_Bump(context: PluginContext) -> Bump:  # noqa: N802
    """Make the resource."""
    return Bump(context.plugin.world, context.plugin.robot)


def create_Range(context: PluginContext) -> Range:  # noqa: N802
    """Make the resource."""
    return Range(context.plugin.world, context.plugin.robot)


def create_Camera(context: PluginContext) -> Camera:  # noqa: N802
    """Make the resource."""
    return Camera(context.plugin.world, context.plugin.robot)


def _destroy(resource: Resource) -> None:
    """Let go of what `create_...` took: nothing, the robot stays in the world."""


destroy_Base = destroy_Pose = destroy_Bump = destroy_Range = destroy_Camera = _destroy  # noqa: N816
