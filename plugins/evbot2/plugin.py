"""The evbot2 plugin: a tracked base over a serial line (Source: thesis §6.1.1)."""

from __future__ import annotations

import math
from typing import Final, Literal, Self

from pydantic import model_validator

from eal_actors.plugin import Drivetrain, Field, OdometryNoise, PluginContext, open_serial

from .base import Base
from .connecting import EvBotPlugin, SessionSettings, disconnect, open_base_port, start_session
from .emulator import TRACKS, simulated_evbot2
from .messages import MAX_NUMBER, TAGS, BaseReply, Code, OrderChannel, State, Verb, WheelStatus
from .odometry import Odometer
from .protocol import BAUD_RATE, MODEL, encode_reply, host_codec
from .session import BaseSession

__all__ = ["Settings", "connect", "disconnect"]

DRIVETRAIN: Final = Drivetrain(
    "evbot2", TRACKS.track_m, 0.25, TRACKS.max_speed_m_s, 60.0, 120.0, TRACKS.acceleration_m_s2, 0.18
)
"""The EvBot II."""

NOISE: Final = OdometryNoise(DRIVETRAIN.track_m, 0.004, 0.006, scale_share=0.01, drift_rad_m=0.05, turn_share=0.15)
"""Its tracks skid: they turn less than they count, by how much depends on the floor."""

_LONGEST: Final = WheelStatus(MAX_NUMBER, TAGS - 1, State.SILENT, -MAX_NUMBER, -MAX_NUMBER, 1)
_STATUS_BITS: Final = 10 * len(encode_reply(BaseReply(Verb.STAT, TAGS - 1, Code.OK, _LONGEST)))
_LINE_SHARE: Final = 0.9
"""The share of the line that the replies to polls may take. If they took more, each would come later than the last."""


class Settings(SessionSettings):
    """The plugin's settings in the fleet file."""

    port: str = Field(min_length=1)
    """The serial port: a device path, a URL of pyserial, such as socket://host:port, or sim://world/<robot>."""
    baudrate: Literal[9600, 19200, 38400, 57600, 115200] = BAUD_RATE
    """Baud rate of a device path."""
    dtr: bool = True
    """Level of the control line DTR: false where it would reset the micro-controller."""
    rts: bool = True
    """Level of the control line RTS."""

    @model_validator(mode="after")
    def _check_line(self) -> Self:
        most_hz = math.floor(_LINE_SHARE * self.baudrate / _STATUS_BITS)
        if self.poll_hz > most_hz:
            raise ValueError(f"poll_hz must be at most {most_hz} at {self.baudrate} baud, not {self.poll_hz:g}")
        return self


def connect(context: PluginContext) -> EvBotPlugin:
    """Open the port and greet the base; an absent base is not ready, and greeted when it appears.

    Raises:
        PluginError: the port is invalid.

    Thread: the robot's; see open_base_port and start_session.
    """
    settings: Settings = context.settings
    port = open_base_port(
        context,
        settings.port,
        DRIVETRAIN.name,
        simulated_evbot2,
        lambda: open_serial(settings.port, baudrate=settings.baudrate, dtr=settings.dtr, rts=settings.rts),
    )
    channels = (OrderChannel.WHEELS,)
    session, odometer = start_session(context, port, host_codec(), model=MODEL, channels=channels, noise=NOISE)
    return plugin_of(context, session, odometer)


def plugin_of(context: PluginContext, session: BaseSession, odometer: Odometer) -> EvBotPlugin:
    """Return the plugin of a session."""
    return EvBotPlugin(context, session, odometer, lambda: Base(session, odometer, DRIVETRAIN, context))
