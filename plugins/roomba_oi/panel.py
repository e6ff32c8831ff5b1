"""What only a Roomba with the Open Interface has: its buttons, its lights, and its few places for songs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from eal_actors.plugin import Activity, DataType, EALData, Resource, ResourceType, ValueInfo, command, request

from ..mote_roomba import panel, sensors
from ..mote_roomba.driver import RoombaDriver
from . import protocol
from .protocol import SONGS

_FLAG: Final = ValueInfo(DataType.BOOL)
_LEVEL: Final = ValueInfo(DataType.INT, None, 0, 255)


class Song(panel.Song):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    places = SONGS


class WheelDrop(sensors.Sensor):
    """Whether a wheel hangs over a drop; the caster of these Roombas does not tell."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any wheel has dropped."""
        return self._answer(lambda sees: sees.contacts.any_drop)

    @request("left", _FLAG)
    def left(self) -> EALData:
        """Return whether the left wheel has dropped."""
        return self._answer(lambda sees: sees.contacts.drop_left)

    @request("right", _FLAG)
    def right(self) -> EALData:
        """Return whether the right wheel has dropped."""
        return self._answer(lambda sees: sees.contacts.drop_right)


class Buttons(sensors.Sensor):
    """Whether any button on the robot is pressed."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any of them is pressed now."""
        return self._answer(lambda sees: bool(sees.pressed))

    @request("clean", _FLAG)
    def clean(self) -> EALData:
        """Return whether CLEAN is pressed."""
        return self._is_pressed("clean")

    @request("spot", _FLAG)
    def spot(self) -> EALData:
        """Return whether SPOT is pressed."""
        return self._is_pressed("spot")

    @request("dock", _FLAG)
    def dock(self) -> EALData:
        """Return whether DOCK is pressed."""
        return self._is_pressed("dock")

    @request("day", _FLAG)
    def day(self) -> EALData:
        """Return whether DAY is pressed."""
        return self._is_pressed("day")

    @request("hour", _FLAG)
    def hour(self) -> EALData:
        """Return whether HOUR is pressed."""
        return self._is_pressed("hour")

    @request("minute", _FLAG)
    def minute(self) -> EALData:
        """Return whether MINUTE is pressed."""
        return self._is_pressed("minute")

    @request("schedule", _FLAG)
    def schedule(self) -> EALData:
        """Return whether SCHEDULE is pressed."""
        return self._is_pressed("schedule")

    @request("clock", _FLAG)
    def clock(self) -> EALData:
        """Return whether CLOCK is pressed."""
        return self._is_pressed("clock")

    def _is_pressed(self, name: str) -> EALData:
        return self._answer(lambda sees: name in sees.pressed)


class Leds(Resource):
    """The lights on the robot; requests return their last settings."""

    types = ResourceType.ACTUATOR

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba
        self._lights = protocol.Leds()

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    def halt(self) -> None:
        """Do nothing: a light does not move."""

    @command("debris", _FLAG)
    def set_debris(self, on: bool) -> Activity:
        """Switch the debris light on or off."""
        return self._set(debris=on)

    @command("spot", _FLAG)
    def set_spot(self, on: bool) -> Activity:
        """Switch the light of SPOT on or off."""
        return self._set(spot=on)

    @command("dock", _FLAG)
    def set_dock(self, on: bool) -> Activity:
        """Switch the light of DOCK on or off."""
        return self._set(dock=on)

    @command("check_robot", _FLAG)
    def set_check_robot(self, on: bool) -> Activity:
        """Switch the light that asks to look after the robot on or off."""
        return self._set(check_robot=on)

    @command("power_colour<level>", _LEVEL)
    def set_power_colour(self, level: int) -> Activity:
        """Set the colour of the power light, from 0 green to 255 red."""
        return self._set(power_colour=level)

    @command("power_intensity<level>", _LEVEL)
    def set_power_intensity(self, level: int) -> Activity:
        """Set the intensity of the power light, from 0 off to 255 full."""
        return self._set(power_intensity=level)

    @command("off")
    def switch_off(self) -> Activity:
        """Switch all lights off."""
        return self._show(protocol.Leds())

    @request("debris", _FLAG)
    def debris(self) -> bool:
        """Return whether the debris light is on."""
        return self._lights.debris

    @request("spot", _FLAG)
    def spot(self) -> bool:
        """Return whether the light of SPOT is on."""
        return self._lights.spot

    @request("dock", _FLAG)
    def dock(self) -> bool:
        """Return whether the light of DOCK is on."""
        return self._lights.dock

    @request("check_robot", _FLAG)
    def check_robot(self) -> bool:
        """Return whether the light that asks to look after the robot is on."""
        return self._lights.check_robot

    @request("power_colour", _LEVEL)
    def power_colour(self) -> int:
        """Return the power light's colour, from 0 green to 255 red."""
        return self._lights.power_colour

    @request("power_intensity", _LEVEL)
    def power_intensity(self) -> int:
        """Return the power light's intensity, from 0 off to 255 full."""
        return self._lights.power_intensity

    def _set(self, **changes: Any) -> Activity:
        return self._show(replace(self._lights, **changes))

    def _show(self, lights: protocol.Leds) -> Activity:
        yield from self._roomba.command(protocol.leds(lights))
        self._lights = lights
