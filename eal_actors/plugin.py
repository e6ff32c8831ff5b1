"""The plugin API: the only module of the framework that plugins import.

A plugin is a folder with a `plugin.yaml` (its manifest) and a `plugin.py`, which contains

- `connect()` or `connect(context)`, returning `EALPlugin("ResourceA", ...)`;
- `disconnect(plugin)`;
- for each resource named there, `create_ResourceA()` or `create_ResourceA(context)` returning a Resource, and
  `destroy_ResourceA(resource)`; or `connect` returns a `FactoryPlugin`, which makes them by functions of its own.

A plugin with settings also contains a class `Settings(PluginSettingsModel)`; the fleet file's settings are checked
against it and arrive as `context.settings` (Source: thesis §4.2.2, B.3).
"""

from __future__ import annotations

from pydantic import Field

from eal_actors.device.data import DataType, EALData
from eal_actors.device.data.texts import finite_json, json_object
from eal_actors.device.differential_base import (
    DifferentialBase,
    Drivetrain,
    MobileBaseSettings,
    Radius,
    Speed,
    WheelCalibration,
)
from eal_actors.device.info import CommandInfo, ConfigInfo, ResourceInfo, ResourceType, ValueInfo
from eal_actors.device.link import FaultyLink as Link
from eal_actors.device.localization.localizer import Localizer
from eal_actors.device.localization.odometry_noise import OdometryNoise
from eal_actors.device.localization.pose_estimate import PoseEstimate, is_plausible, wrapped_rad
from eal_actors.device.localization.pose_resource import PoseResource, finite_pose
from eal_actors.device.markers import FAMILIES, FamilyName
from eal_actors.device.motion.slip_watch import MOST_SLIP_M, MOST_TURN_SLIP_M, SlipWatch, slip_error
from eal_actors.device.plugin_context import EALPlugin, FactoryPlugin, FleetServices, PluginContext, PluginSettingsModel
from eal_actors.device.ports import BytePort, ReopeningDevice, ReopeningPort
from eal_actors.device.resource import Activity, Resource, command, config, config_setter, request, setting
from eal_actors.device.serial_ports import open_serial
from eal_actors.device.serving_emulators import PacedEmulator, serve_emulator
from eal_actors.device.sockets import TcpPort, UdpPort, open_tcp
from eal_actors.device.velocity_base import OdometryReading, VelocityBase
from eal_actors.device.world import FloorMarker
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import (
    ArgumentError,
    BlockedError,
    DataError,
    EALError,
    LocalizationError,
    NotReadyError,
    PluginError,
    ResourceFaultError,
    UnavailableError,
    UnsupportedError,
)
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.log_limit import LogLimit

__all__ = [
    "FAMILIES",
    "MOST_SLIP_M",
    "MOST_TURN_SLIP_M",
    "Activity",
    "ArgumentError",
    "BlockedError",
    "BytePort",
    "Clock",
    "CommandInfo",
    "ConfigInfo",
    "DataError",
    "DataType",
    "DifferentialBase",
    "Drivetrain",
    "EALData",
    "EALError",
    "EALPlugin",
    "FactoryPlugin",
    "FamilyName",
    "Field",
    "FleetServices",
    "FloorMarker",
    "Link",
    "LocalizationError",
    "Localizer",
    "LogLimit",
    "MobileBaseSettings",
    "NotReadyError",
    "OdometryNoise",
    "OdometryReading",
    "PacedEmulator",
    "PluginContext",
    "PluginError",
    "PluginSettingsModel",
    "PoseEstimate",
    "PoseResource",
    "Radius",
    "ReopeningDevice",
    "ReopeningPort",
    "Resource",
    "ResourceFaultError",
    "ResourceInfo",
    "ResourceType",
    "SlipWatch",
    "Speed",
    "TcpPort",
    "UdpPort",
    "UnavailableError",
    "UnsupportedError",
    "ValueInfo",
    "VelocityBase",
    "WheelCalibration",
    "command",
    "config",
    "config_setter",
    "finite_json",
    "finite_pose",
    "get_logger",
    "is_plausible",
    "json_object",
    "open_serial",
    "open_tcp",
    "request",
    "serve_emulator",
    "setting",
    "slip_error",
    "wrapped_rad",
]
