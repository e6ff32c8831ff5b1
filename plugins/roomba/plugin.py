"""The roomba plugin: iRobot's Roombas and the Create 2 over a serial interface (Source: thesis §6.1.3)."""

from __future__ import annotations

from eal_actors.plugin import FactoryPlugin, OdometryNoise, PluginContext, PoseResource

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


class RoombaPlugin(FactoryPlugin):
    """A Roomba at the other end of a link."""

    def __init__(self, context: PluginContext, roomba: RoombaDriver) -> None:
        is_oi = isinstance(roomba, OiDriver)
        super().__init__(
            {
                "Base": lambda: RoombaBase(roomba, context),
                "Bump": lambda: RoombaBump(roomba),
                "Cliff": lambda: RoombaCliff(roomba),
                "WheelDrop": lambda: OiWheelDrop(roomba) if is_oi else SciWheelDrop(roomba),
                "Wall": lambda: RoombaWall(roomba),
                "Battery": lambda: RoombaBattery(roomba),
                "Odometry": lambda: RoombaOdometry(roomba),
                "Pose": lambda: PoseResource(context.localizer, context.clock),
                "Buttons": lambda: OiButtons(roomba) if is_oi else SciButtons(roomba),
                "Leds": lambda: OiLeds(roomba) if is_oi else SciLeds(roomba),
                "Song": lambda: OiSong(roomba) if is_oi else RoombaSong(roomba),
                "Power": lambda: RoombaPower(roomba),
            }
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
    return RoombaPlugin(context, roomba)


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
