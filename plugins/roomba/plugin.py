"""The roomba plugin: iRobot's Roombas and the Create 2 over a serial interface (Source: thesis §6.1.3)."""

# ruff: noqa: N802, N816  # create_Base and its like are names of the plugin API

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from eal_actors.plugin import EALPlugin, OdometryNoise, PluginContext, PoseResource, Resource

from . import oi
from .base import RoombaBase
from .bodies import RoombaBody
from .driver import RoombaDriver
from .emulator import SIMULATED_WHEELBASE_M, make_emulator
from .link import RoombaLink, SerialLink, open_port
from .mote_link import MoteLink
from .motes import ByteEmulator, MotePair
from .oi_driver import OiDriver
from .panel import OiButtons, OiLeds, OiSong, RoombaSong, SciButtons, SciLeds
from .resources import (
    OiWheelDrop,
    RoombaBattery,
    RoombaBump,
    RoombaCliff,
    RoombaOdometry,
    RoombaPower,
    RoombaWall,
    SciWheelDrop,
)
from .sci import Mode
from .sci_driver import SciDriver
from .settings import Settings

__all__ = ["Settings", "connect", "disconnect"]

ResourceKind: TypeAlias = Callable[[RoombaDriver], Resource]


class RoombaPlugin(EALPlugin):
    """A Roomba at the other end of a link."""

    def __init__(self, roomba: RoombaDriver) -> None:
        super().__init__(
            "Base",
            "Bump",
            "Cliff",
            "WheelDrop",
            "Wall",
            "Battery",
            "Odometry",
            "Pose",
            "Buttons",
            "Leds",
            "Song",
            "Power",
        )
        self.roomba = roomba


def connect(context: PluginContext) -> RoombaPlugin:
    """Open the port and wake the Roomba. One that is absent or silent is not ready, and is tried again.

    Raises:
        PluginError: the port can never be opened.

    Thread: the robot's; waits until the first reading has come, so that the resources can answer from their start.
    """
    settings: Settings = context.settings
    mode, link = Mode(settings.mode), _link(context, settings)
    roomba: RoombaDriver
    if settings.protocol == "sci":
        roomba = SciDriver(link, context.clock, mode, settings.poll_hz, context.robot)
    else:
        wheelbase_m = SIMULATED_WHEELBASE_M if settings.is_simulated else oi.WHEELBASE_M
        roomba = OiDriver(link, context.clock, mode, settings.poll_hz, context.robot, wheelbase_m)
    roomba.calibration, roomba.localizer = settings.calibration, context.localizer
    noise = OdometryNoise(roomba.wheelbase_m, 0.0008, 0.002, scale_share=0.005, drift_rad_m=0.02, turn_share=0.015)
    roomba.localizer.attach(noise, refresh=roomba.latest, not_ready=roomba.not_ready)
    try:
        for delay_s in roomba.wake():
            roomba.clock.sleep(delay_s)
    except BaseException:
        roomba.close()
        raise
    return RoombaPlugin(roomba)


def disconnect(plugin: RoombaPlugin) -> None:
    """Release the Roomba and close the port; the base has stopped the Roomba before."""
    roomba = plugin.roomba
    try:
        for delay_s in roomba.farewell():
            roomba.clock.sleep(delay_s)
    finally:
        roomba.close()


def _link(context: PluginContext, settings: Settings) -> RoombaLink:
    def emulate(body: RoombaBody) -> ByteEmulator:
        roomba = make_emulator(settings.protocol, body, SIMULATED_WHEELBASE_M)
        return MotePair(roomba, settings.motes().framing()) if settings.link == "mote" else roomba

    port = open_port(context, settings.url, settings.line_baudrate, emulate)
    if settings.link != "mote":
        return SerialLink(port)
    mote = settings.motes()
    return MoteLink(port, context.clock, mote.framing(), mote.tries)


def _creator(sci_kind: ResourceKind, oi_kind: ResourceKind | None = None) -> Callable[[PluginContext], Resource]:
    """Return the function that creates a resource; `oi_kind` where it differs with the Open Interface."""
    kinds = {"sci": sci_kind, "oi": oi_kind or sci_kind}

    def create(context: PluginContext) -> Resource:
        """Create the resource."""
        return kinds[context.plugin.roomba.protocol](context.plugin.roomba)

    return create


def create_Base(context: PluginContext) -> RoombaBase:
    """Create the base."""
    return RoombaBase(context.plugin.roomba, context)


def _create_pose(context: PluginContext) -> PoseResource:
    """Create the pose estimate."""
    return PoseResource(context.localizer, context.clock)


def destroy(resource: Resource) -> None:
    """Do nothing: the Roomba belongs to the plugin."""


destroy_Base = destroy
create_Bump, destroy_Bump = _creator(RoombaBump), destroy
create_Cliff, destroy_Cliff = _creator(RoombaCliff), destroy
create_WheelDrop, destroy_WheelDrop = _creator(SciWheelDrop, OiWheelDrop), destroy
create_Wall, destroy_Wall = _creator(RoombaWall), destroy
create_Battery, destroy_Battery = _creator(RoombaBattery), destroy
create_Odometry, destroy_Odometry = _creator(RoombaOdometry), destroy
create_Pose, destroy_Pose = _create_pose, destroy
create_Buttons, destroy_Buttons = _creator(SciButtons, OiButtons), destroy
create_Leds, destroy_Leds = _creator(SciLeds, OiLeds), destroy
create_Song, destroy_Song = _creator(RoombaSong, OiSong), destroy
create_Power, destroy_Power = _creator(RoombaPower), destroy
