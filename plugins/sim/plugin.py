"""The sim plugin: one robot in the world that all simulated robots of a fleet share."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Self

from pydantic import model_validator
from typing_extensions import override

from eal_actors.plugin import (
    FactoryPlugin,
    Field,
    FleetServices,
    PluginContext,
    PluginError,
    PluginSettingsModel,
    Resource,
    WheelCalibration,
    get_logger,
)

from . import resources
from .faults import SENSORS, FaultPlan, PlannedFault
from .models import MAKES, MakeName
from .overhead import open_camera
from .port import open_port
from .resources.depth_camera import DepthCameraSettings
from .resources.imu import ImuSettings
from .resources.lidar import LidarSettings
from .resources.robot_resource import RobotResource, apply_faults
from .robot import SimRobot
from .world import SimWorld, world_of

__all__ = ["Settings", "SimPlugin", "connect", "disconnect", "open_camera", "open_port"]

_NO_PICTURES = "pictures need OpenCV: pip install 'eal-actors[vision]'"
_ALL_MAKES = (
    "Base",
    "Odometry",
    "Battery",
    "Pose",
    "TruePose",
    "Bump",
    "Range",
    "Compass",
    "Light",
    "Beacons",
    "Camera",
    "Faults",
)
_ROOMBA_ALONE = ("Cliff", "WheelDrop", "Wall", "Buttons", "Leds", "Song")
_ADDED = (resources.Lidar, resources.Imu, resources.DepthCamera)


class StartSettings(PluginSettingsModel):
    """The start pose, in the world's frame: the origin in the middle, x right, y up."""

    x_m: float
    y_m: float
    yaw_deg: float = Field(default=0.0, ge=-360, le=360)


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    synonyms = {"pose": "start", "position": "start", "type": "model", "make": "model"}  # noqa: RUF012

    model: MakeName
    """The make of the robot."""
    start: StartSettings | None = None
    """Default: one of the world's start poses or a free place, in the order of the robots' names."""
    noise: bool = True
    """Whether the wheels have the make's errors."""
    calibrated: bool = True
    """Whether only the errors that remain after a calibration are simulated."""
    calibration: WheelCalibration = WheelCalibration()
    """The wheel errors that the base compensates, as measured by `eal calibrate`."""
    charge: float = Field(default=1.0, ge=0, le=1)
    """The initial charge of the battery."""
    lidar: LidarSettings | None = None
    """A lidar; `{}` for one with the defaults."""
    imu: ImuSettings | None = None
    """An inertial measurement unit; `{}` for one with the defaults."""
    depth_camera: DepthCameraSettings | None = None
    """A depth camera; `{}` for one with the defaults."""
    faults: tuple[PlannedFault, ...] = Field(default=(), strict=False)
    """Injected faults, with their times."""

    @property
    def resources(self) -> tuple[str, ...]:
        """The names of the robot's resources: those of its make, and the sensors that the settings add."""
        make = MAKES[self.model]
        turret = ("Turret",) if make.turret else ()
        added = tuple(kind.__name__ for kind in _ADDED if getattr(self, kind.settings_key) is not None)
        return _ALL_MAKES + turret + (_ROOMBA_ALONE if make.name == "roomba" else ()) + added

    @model_validator(mode="after")
    def _check_fault_names(self) -> Self:
        lacking = {name for fault in self.faults for name in fault.frozen + fault.failing}.difference(self.resources)
        if lacking:
            raise ValueError(f"faults: the {self.model} has no {', '.join(sorted(lacking))} to freeze or to fail")
        return self

    @override
    def refused_changes(self, former: Self) -> dict[str, str]:
        """Refuse what belongs to the robot's body, which stays in the world."""
        keys = ("model", "start", "noise", "calibrated", "charge")
        changed = [key for key in keys if getattr(self, key) != getattr(former, key)]
        return dict.fromkeys(changed, "cannot change while the robot is in the simulated world; close the fleet first")

    @override
    @classmethod
    def refused_in(cls, services: FleetServices, robots: Mapping[str, Self]) -> dict[str, dict[str, str]]:
        """Refuse starts outside the room, or where something else is."""
        world, refused = world_of(services), {}
        for name, settings in robots.items():
            try:
                settings.join(world, name)
            except PluginError as error:
                refused[name] = {"start": error.message}
        return refused

    def join(self, world: SimWorld, name: str) -> SimRobot:
        """Put a robot into the world. Raises PluginError: its start is not free, or it is there with other settings."""
        at = self.start
        return world.join(
            name,
            MAKES[self.model] if self.calibrated else MAKES[self.model].uncalibrated(),
            noise=self.noise,
            start=(float(at.x_m), float(at.y_m), math.radians(at.yaw_deg)) if at else None,
            charge=self.charge,
            calibration=self.calibration,
        )


def _left_out(context: PluginContext) -> dict[str, str]:
    """Return the resources that do not work here, and why: without OpenCV there are no pictures."""
    if importlib.util.find_spec("cv2") is not None:
        return {}
    context.services.shared("sim.without_pictures", _warn_of_pictures)  # once for all robots of a fleet
    return {"Camera": _NO_PICTURES}


def _warn_of_pictures() -> None:
    get_logger().warning(f"Camera is left out: {_NO_PICTURES}")


class SimPlugin(FactoryPlugin):
    """A robot in the fleet's simulated world."""

    def __init__(self, context: PluginContext, world: SimWorld, robot: SimRobot) -> None:
        settings: Settings = context.settings
        is_calibrated = settings.calibrated or settings.calibration != WheelCalibration()

        def make(name: str) -> Resource:
            kind: type[RobotResource] = getattr(resources, name)
            own = (getattr(settings, kind.settings_key),) if kind.settings_key else ()
            return apply_faults(kind(world, robot, *own), robot)

        def make_pose() -> Resource:
            pose = resources.Pose(world, robot, context.localizer, context.clock, is_calibrated=is_calibrated)
            return apply_faults(pose, robot)

        left_out = _left_out(context)
        names = [name for name in settings.resources if name not in left_out]
        makers: dict[str, Callable[[], Resource]] = {name: partial(make, name) for name in names}
        makers["Base"] = lambda: apply_faults(resources.Base(world, robot, context), robot)
        makers["Pose"] = make_pose
        makers["TruePose"] = lambda: resources.TruePose(world, robot)  # no fault affects it
        makers["Faults"] = lambda: _faults(context, world, robot)
        super().__init__(makers, tuple(left_out.values()))
        self.world = world
        self.robot = robot


def _faults(context: PluginContext, world: SimWorld, robot: SimRobot) -> resources.Faults:
    """Create the faults; their plan outlives the resource, so that a restart does not begin it again."""
    services = context.services
    plan = services.shared(("sim.faults", context.robot), lambda: FaultPlan(context.settings.faults))
    own = context.settings.resources
    names = {"frozen": tuple(name for name in own if name in SENSORS), "failing": own}
    return resources.Faults(world, robot, services.link(context.robot), plan, context.clock, names)


def connect(context: PluginContext) -> SimPlugin:
    """Put the robot into the world.

    Raises:
        PluginError: its start is not free, or it is in the world with other settings.
    """
    world = world_of(context.services)
    robot = context.settings.join(world, context.robot)
    beside = ("Faults", "TruePose")  # link faults do not affect these: they are not part of the robot
    context.services.link(context.robot).spare(beside + tuple(f"{context.instance}.{name}" for name in beside))
    return SimPlugin(context, world, robot)


def disconnect(plugin: SimPlugin) -> None:
    """Stop the robot; it stays in the world."""
    with plugin.world.lock:
        plugin.world.catch_up()
        plugin.world.stop(plugin.robot)
