"""The buttons, lights and songs of a simulated Roomba. They have the interface of the real robot's resources."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import (
    DataType,
    EALData,
    ResourceType,
    ValueInfo,
    command,
    request,
)

from ...roomba.songs import NOTES, SongBook, duration_s, parse_notes
from ..robot import SimRobot
from ..world import SimWorld
from .robot_resource import RobotResource

_FLAG: Final = ValueInfo(DataType.BOOL)
_STATUS: Final = ValueInfo(DataType.CHAR, choices=("off", "red", "green", "amber"))
_LEVEL: Final = ValueInfo(DataType.INT, None, 0, 255)


class Buttons(RobotResource):
    """Whether any button on the robot is pressed."""

    types = ResourceType.SENSOR
    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any of the four is pressed now; in simulation, none ever is."""
        return self._read(lambda _: False)

    @request("max", _FLAG)
    def max(self) -> EALData:
        """Return whether MAX is pressed."""
        return self._read(lambda _: False)

    @request("clean", _FLAG)
    def clean(self) -> EALData:
        """Return whether CLEAN is pressed."""
        return self._read(lambda _: False)

    @request("spot", _FLAG)
    def spot(self) -> EALData:
        """Return whether SPOT is pressed."""
        return self._read(lambda _: False)

    @request("power", _FLAG)
    def power(self) -> EALData:
        """Return whether POWER is pressed."""
        return self._read(lambda _: False)


@dataclass(frozen=True, slots=True)
class _Lights:
    dirt: bool = False
    max: bool = False
    clean: bool = False
    spot: bool = False
    status: str = "off"
    power_colour: int = 0
    power_intensity: int = 0


class Leds(RobotResource):
    """The lights on the robot; requests return their last settings."""

    types = ResourceType.ACTUATOR

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._lights = _Lights()

    def halt(self) -> None:
        """Do nothing: a light does not move."""

    @command("dirt", _FLAG, repeatable=True)
    def set_dirt(self, on: bool) -> None:
        """Switch the dirt light on or off."""
        self._set(dirt=on)

    @command("max", _FLAG, repeatable=True)
    def set_max(self, on: bool) -> None:
        """Switch the light of MAX on or off."""
        self._set(max=on)

    @command("clean", _FLAG, repeatable=True)
    def set_clean(self, on: bool) -> None:
        """Switch the light of CLEAN on or off."""
        self._set(clean=on)

    @command("spot", _FLAG, repeatable=True)
    def set_spot(self, on: bool) -> None:
        """Switch the light of SPOT on or off."""
        self._set(spot=on)

    @command("status", _STATUS, repeatable=True)
    def set_status(self, colour: str) -> None:
        """Set the status light."""
        self._set(status=colour)

    @command("power_colour<level>", _LEVEL, repeatable=True)
    def set_power_colour(self, level: int) -> None:
        """Set the colour of the power light, from 0 green to 255 red."""
        self._set(power_colour=level)

    @command("power_intensity<level>", _LEVEL, repeatable=True)
    def set_power_intensity(self, level: int) -> None:
        """Set the intensity of the power light, from 0 off to 255 full."""
        self._set(power_intensity=level)

    @command("off", repeatable=True)
    def switch_off(self) -> None:
        """Switch all lights off."""
        self._lights = _Lights()

    @request("dirt", _FLAG)
    def dirt(self) -> bool:
        """Return whether the dirt light is on."""
        return self._lights.dirt

    @request("max", _FLAG)
    def max(self) -> bool:
        """Return whether the light of MAX is on."""
        return self._lights.max

    @request("clean", _FLAG)
    def clean(self) -> bool:
        """Return whether the light of CLEAN is on."""
        return self._lights.clean

    @request("spot", _FLAG)
    def spot(self) -> bool:
        """Return whether the light of SPOT is on."""
        return self._lights.spot

    @request("status", _STATUS)
    def status(self) -> str:
        """Return the status light's colour."""
        return self._lights.status

    @request("power_colour", _LEVEL)
    def power_colour(self) -> int:
        """Return the power light's colour, from 0 green to 255 red."""
        return self._lights.power_colour

    @request("power_intensity", _LEVEL)
    def power_intensity(self) -> int:
        """Return the power light's intensity, from 0 off to 255 full."""
        return self._lights.power_intensity

    def _set(self, **changes: Any) -> None:
        self._lights = replace(self._lights, **changes)


class Song(SongBook, RobotResource):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        SongBook.__init__(self)
        RobotResource.__init__(self, world, robot)
        self._plays_until_s = 0.0

    @override
    def remaining_s(self) -> float:
        with self._world.caught_up() as now_s:
            return self._plays_until_s - now_s

    @command("notes", NOTES, repeatable=True)
    def set_notes(self, text: str) -> None:
        """Store the song's notes, at most 16."""
        parse_notes(text)
        self._songs[self._number] = text

    @command("play")
    def play(self) -> None:
        """Begin to play the song."""
        notes = self.playable_notes()
        with self._world.caught_up() as now_s:
            self._plays_until_s = now_s + duration_s(notes)
