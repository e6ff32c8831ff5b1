"""The start of the plugins of both EvBots: settings, the port, and the first greeting."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Self

from pydantic import model_validator

from eal_actors.plugin import (
    BytePort,
    FactoryPlugin,
    Field,
    OdometryNoise,
    PluginContext,
    PluginSettingsModel,
    PoseResource,
    ReopeningPort,
    Resource,
    WheelCalibration,
)

from .codec import Codec
from .firmware import BaseEmulator
from .messages import WATCHDOG_MS, BaseReply, BaseRequest, OrderChannel
from .odometry import Odometer, Odometry
from .session import BaseSession
from .watchdog import POLLS

_FIRST_GREETING_S: Final = 2.0  # so that the first call finds a base that a busy computer serves late


class SessionSettings(PluginSettingsModel):
    """The settings common to both EvBots."""

    poll_hz: float = Field(default=20.0, ge=5, le=50)
    """Polls of the base per second."""
    watchdog_s: float | None = Field(default=None, ge=WATCHDOG_MS[0] / 1000, le=WATCHDOG_MS[1] / 1000)
    """The base stops after this time without a message; at least three polls. By default it follows the measured round
    trips, within 0.5 s and 2 s."""
    calibration: WheelCalibration = WheelCalibration()
    """The wheel calibration, as measured by `eal calibrate`."""

    @model_validator(mode="after")
    def _check_watchdog(self) -> Self:
        least_s = POLLS / self.poll_hz
        if self.watchdog_s is not None and self.watchdog_s < least_s:
            raise ValueError(
                f"watchdog_s must be at least {POLLS} polls, {least_s:g} s at poll_hz {self.poll_hz:g}, "
                f"not {self.watchdog_s:g}"
            )
        return self


class EvBotPlugin(FactoryPlugin):
    """An EvBot at the other end of a port.

    Args:
        odometer: counts its wheels.
        base: makes the base.
        others: make what only this EvBot has.
    """

    def __init__(
        self,
        context: PluginContext,
        session: BaseSession,
        odometer: Odometer,
        base: Callable[[], Resource],
        **others: Callable[[], Resource],
    ) -> None:
        super().__init__(
            {
                "Base": base,
                "Odometry": lambda: Odometry(session, odometer),
                "Pose": lambda: PoseResource(context.localizer, context.clock),
                **others,
            }
        )
        self.session = session


def disconnect(plugin: EvBotPlugin) -> None:
    """Close the port; the base is stopped already."""
    plugin.session.close()


def open_base_port(
    context: PluginContext,
    url: str,
    make: str,
    emulate: Callable[[Any], BaseEmulator],
    open_real: Callable[[], BytePort],
) -> ReopeningPort:
    """Open the port to a base: a simulated one for `sim://world/<robot>`, else a real one.

    `make` is that of a simulated robot, whose emulator `emulate` creates for its vehicle.

    Raises:
        PluginError: the configuration is wrong.

    Thread: the robot's; blocks while a network port opens.
    """
    is_simulated = url.startswith("sim:")
    port = ReopeningPort(
        (lambda: context.simulated_port(url, make, emulate)) if is_simulated else open_real, context.clock, url
    )
    port.open()
    return port


def start_session(
    context: PluginContext,
    port: ReopeningPort,
    codec: Codec[BaseReply, BaseRequest],
    *,
    model: int,
    channels: tuple[OrderChannel, ...],
    noise: OdometryNoise,
) -> tuple[BaseSession, Odometer]:
    """Greet the base; an absent base is greeted when it appears. The context has SessionSettings.

    Thread: the robot's; waits at most two seconds for a base that is silent.
    """
    settings: SessionSettings = context.settings
    odometer = Odometer(noise.track_m, settings.calibration, context.localizer)
    session = BaseSession(
        port,
        codec,
        context.clock,
        model=model,
        channels=channels,
        poll_hz=settings.poll_hz,
        watchdog_s=settings.watchdog_s,
        on_reading=odometer.follow,
        name=context.robot,
    )
    context.localizer.attach(noise, refresh=session.latest, not_ready=session.why_not_ready)
    try:
        for delay_s in session.greet(_FIRST_GREETING_S):
            context.clock.sleep(delay_s)
    except BaseException:
        session.close()
        raise
    return session, odometer
