"""The autopilot: arming, modes, take-off and landing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pymavlink.dialects.v20 import common as mavlink
from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DataType,
    Resource,
    ResourceFaultError,
    ResourceType,
    UnavailableError,
    UnsupportedError,
    ValueInfo,
    command,
)

from .link import MavLink
from .protocol import OFFBOARD, PX4, guided_mode, mode_parameters
from .settings import Settings

_POLL_S: Final = 0.05
_CONFIRM_S: Final = 5.0
_STREAM_S: Final = 1.0
"""How long PX4 must have received set-points before it switches to OFFBOARD."""
_FLIGHT_S: Final = 110.0
"""Allowed for a take-off or a landing."""
_ALTITUDE: Final = ValueInfo(DataType.DOUBLE, "m", 0.1, 500)


def make_guided(link: MavLink, vehicle: str) -> Activity:
    """Switch to the mode that takes set-points, and arm.

    Raises:
        ResourceFaultError: the autopilot refuses it.
        UnavailableError: it does not answer.
    """
    wanted = guided_mode(link.autopilot())
    if link.mode() != wanted:
        yield from switch(link, vehicle, wanted)
    if not link.is_armed():
        yield from link.command("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        yield from _until(link.is_armed, "is armed")


def switch(link: MavLink, vehicle: str, name: str) -> Activity:
    """Switch the mode; raises what `make_guided` raises, and ArgumentError."""
    parameters = mode_parameters(link.autopilot(), vehicle, name)
    if link.autopilot() == PX4 and name == OFFBOARD:
        link.keep_offboard(_CONFIRM_S)
        yield _STREAM_S
    yield from link.command(f"switch to {name}", mavlink.MAV_CMD_DO_SET_MODE, *parameters)
    yield from _until(lambda: link.mode() == name, f"is in {name}")


def check_guided(link: MavLink) -> None:
    """Raise ResourceFaultError if the vehicle has left the mode that takes set-points, or is disarmed."""
    if not link.is_armed() or link.mode() != guided_mode(link.autopilot()):
        raise ResourceFaultError(f"halted: the vehicle was taken over, it is in {link.mode()}")


def _until(condition: Callable[[], bool], what: str) -> Activity:
    for _ in range(int(_CONFIRM_S / _POLL_S)):
        if condition():
            return
        yield _POLL_S
    raise UnavailableError(f"the vehicle's heartbeat does not say that it {what}")


class Autopilot(Resource):
    """Arms the vehicle and sets its mode; set_value: a mode's name."""

    types = ResourceType.SENSOR | ResourceType.ACTUATOR
    value = ValueInfo(DataType.CHAR, description="the mode's name, such as GUIDED or OFFBOARD")

    def __init__(self, link: MavLink, settings: Settings) -> None:
        self._link = link
        self._settings = settings

    @override
    def not_ready(self) -> str | None:
        return self._link.why_not_ready()

    def get_status(self) -> int:
        """Return 1 while the vehicle is armed, else 0."""
        return int(self._link.is_armed())

    def get_value(self) -> str:
        """Return the mode's name."""
        return self._link.mode()

    def set_value(self, data: object) -> Activity:
        """Switch the mode.

        Raises:
            ArgumentError: the autopilot has no such mode.
            ResourceFaultError: it refuses.
            UnavailableError: it does not answer.
        """
        return switch(self._link, self._settings.vehicle, str(getattr(data, "value", data)))

    @command("guided", takes_s=2 * _CONFIRM_S)
    def guided(self) -> Activity:
        """Switch to the mode that takes set-points, and arm."""
        return make_guided(self._link, self._settings.vehicle)

    @command("arm")
    def arm(self) -> Activity:
        """Arm the motors."""
        yield from self._link.command("arm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        yield from _until(self._link.is_armed, "is armed")

    @command("disarm")
    def disarm(self) -> Activity:
        """Disarm the motors; an autopilot refuses it in flight."""
        yield from self._link.command("disarm", mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        yield from _until(lambda: not self._link.is_armed(), "is disarmed")

    @command("takeoff<metres>", _ALTITUDE, takes_s=_FLIGHT_S)
    def take_off(self, metres: float) -> Activity:
        """Take off to an altitude above the start.

        Raises:
            ArgumentError: it is above the greatest altitude.
            UnsupportedError: the vehicle is a rover.
        """
        if self._settings.vehicle != "copter":
            raise UnsupportedError("a rover does not take off")
        if metres > self._settings.max_altitude_m:
            raise ArgumentError(f"{metres:g} m is above max_altitude_m, {self._settings.max_altitude_m:g} m")
        return self._climb(metres)

    def _climb(self, metres: float) -> Activity:
        yield from make_guided(self._link, self._settings.vehicle)
        start = self._link.reading()
        by_position = self._link.autopilot() == PX4  # the altitude of its take-off command is above the sea
        if not by_position:
            yield from self._link.command("take off", mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, metres)
        while abs(self._link.reading().altitude_m - metres) > 0.2:
            if by_position:
                check_guided(self._link)
                self._link.send_position(start.x_m, start.y_m, metres, None)
            self.progress(self._link.reading().altitude_m / metres)
            yield _POLL_S

    @command("land", takes_s=_FLIGHT_S)
    def land(self) -> Activity:
        """Land here, and wait until the motors are disarmed."""
        yield from self._link.command("land", mavlink.MAV_CMD_NAV_LAND)
        while self._link.is_armed():
            yield _POLL_S

    @override
    def halt(self) -> None:
        """Do nothing: the halt of Base stops the vehicle, and a copter must not be disarmed in flight."""
