"""What the plugins of both EvBots do to come up: settings, the port that comes back, and the first greeting."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Self

from pydantic import model_validator

from eal_actors.plugin import (
    BytePort,
    EALPlugin,
    Field,
    NotReadyError,
    PluginContext,
    PluginSettingsModel,
    ReopeningPort,
    WheelCalibration,
)

from .device import Device
from .messages import WATCHDOG_MS, Channel
from .odometry import Odometer
from .session import HostSide, Way
from .talk import Talk

_MOST_BYTES: Final = 65536
_FIRST_GREETING_S: Final = 0.5
_POLLS_A_WATCHDOG: Final = 3


class TalkSettings(PluginSettingsModel):
    """What the fleet file may set for either EvBot."""

    poll_hz: float = Field(default=20.0, ge=5, le=50)
    """Polls of the base a second."""
    watchdog_s: float = Field(default=0.5, ge=WATCHDOG_MS[0] / 1000, le=WATCHDOG_MS[1] / 1000)
    """The base stops by itself when it hears nothing for so long; at least three polls."""
    calibration: WheelCalibration = WheelCalibration()
    """What is known of the wheels, as `eal calibrate` finds it out."""

    @model_validator(mode="after")
    def _check_watchdog(self) -> Self:
        least_s = _POLLS_A_WATCHDOG / self.poll_hz
        if self.watchdog_s < least_s:
            raise ValueError(
                f"watchdog_s must be at least {_POLLS_A_WATCHDOG} polls, {least_s:g} s at poll_hz {self.poll_hz:g}, "
                f"not {self.watchdog_s:g}"
            )
        return self


class SimulatedWay:
    """A Way through a simulated port, which is there as soon as it is asked for, and never lost.

    Args:
        port: the port.
        name: see Way.
    """

    openings: Final = 1

    def __init__(self, port: BytePort, name: str) -> None:
        self.name: Final = name
        self._port = port
        self._is_closed = False

    def why_not_ready(self) -> str | None:
        """See Way."""
        return f"{self.name} is closed" if self._is_closed else None

    def read(self) -> bytes:
        """See Way."""
        self._check()
        return self._port.read(_MOST_BYTES)

    def write(self, data: bytes) -> int:
        """See Way."""
        self._check()
        return self._port.write(data) or 0

    def close(self) -> None:
        """See Way."""
        self._is_closed = True
        self._port.close()

    def _check(self) -> None:
        if (reason := self.why_not_ready()) is not None:
            raise NotReadyError(reason)


class EvBotPlugin(EALPlugin):
    """An EvBot at the other end of a port."""

    def __init__(self, talk: Talk, odometer: Odometer, *names: str) -> None:
        super().__init__(*names)
        self.talk = talk
        self.odometer = odometer


def way_to(
    context: PluginContext,
    url: str,
    make: str,
    emulate: Callable[[Any], Device],
    open_port: Callable[[], BytePort],
) -> Way:
    """Open the way to a base: to a simulated one for `sim://world/<robot>`, and else to a real one.

    Args:
        context: of the plugin.
        url: what the settings say.
        make: what a simulated robot must be.
        emulate: makes the emulator for a simulated robot's body.
        open_port: opens the port of a real one.

    Raises:
        PluginError: the configuration is wrong.

    Thread: the robot's; waits for a port of a network to open.
    """
    if url.startswith("sim:"):
        return SimulatedWay(context.simulated_port(url, make, emulate), url)
    port = ReopeningPort(open_port, context.clock, url)
    port.open()
    return port


def come_up(
    context: PluginContext,
    way: Way,
    codec: HostSide,
    *,
    model: int,
    channels: tuple[Channel, ...],
    track_m: float,
) -> tuple[Talk, Odometer]:
    """Greet the base; one that is away is greeted when it comes.

    Args:
        context: of the plugin, with TalkSettings.
        way: to the base.
        codec: how the base speaks.
        model: what the base must be.
        channels: what it moves.
        track_m: nominal distance of its wheels.

    Thread: the robot's; waits half a second for the base at most.
    """
    settings: TalkSettings = context.settings
    odometer = Odometer(track_m, settings.calibration)
    talk = Talk(
        way,
        codec,
        context.clock,
        model=model,
        channels=channels,
        poll_hz=settings.poll_hz,
        watchdog_s=settings.watchdog_s,
        on_reading=odometer.follow,
        name=context.robot,
    )
    try:
        for delay_s in talk.greet(_FIRST_GREETING_S):
            context.clock.sleep(delay_s)
    except BaseException:
        talk.close()
        raise
    return talk, odometer
