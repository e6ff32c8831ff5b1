"""The Roomba's panel: lights, songs and buttons. Each kind of Roomba has its own lights and buttons."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    Resource,
    ResourceType,
    ValueInfo,
    command,
    request,
)

from . import oi, sci
from .driver import RoombaDriver
from .oi import OiLights
from .resources import RoombaSensor
from .sci import SciLights, StatusLed
from .songs import NOTES, SongBook, duration_s, parse_notes

_FLAG: Final = ValueInfo(DataType.BOOL)
_STATUS: Final = ValueInfo(DataType.CHAR, choices=("off", "red", "green", "amber"))
_LEVEL: Final = ValueInfo(DataType.INT, None, 0, 255)


def _switch(name: str, light: str) -> Callable[[Any, bool], Activity]:
    """Return the command that switches a light."""

    @command(name, _FLAG, repeatable=True, description=f"Switch {light} on or off.")
    def switch(self: RoombaLeds, on: bool) -> Activity:
        return self.show(**{name: on})

    return switch


def _is_on(name: str, light: str) -> Callable[[Any], bool]:
    """Return the request for the state of a light."""

    @request(name, _FLAG, description=f"Return whether {light} is on.")
    def is_on(self: RoombaLeds) -> bool:
        return bool(getattr(self.lights, name))

    return is_on


class RoombaLeds(Resource):
    """The lights of a Roomba.

    Attributes:
        lights: the lights as they were set last.
    """

    types = ResourceType.ACTUATOR
    dark: ClassVar[SciLights | OiLights]
    """All lights off."""

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba
        self.lights: Any = self.dark

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    def halt(self) -> None:
        """Do nothing: a light does not move."""

    @command("power_colour<level>", _LEVEL, repeatable=True)
    def set_power_colour(self, level: int) -> Activity:
        """Set the colour of the power light, from 0 green to 255 red."""
        return self.show(power_colour=level)

    @command("power_intensity<level>", _LEVEL, repeatable=True)
    def set_power_intensity(self, level: int) -> Activity:
        """Set the intensity of the power light, from 0 off to 255 full."""
        return self.show(power_intensity=level)

    @command("off", repeatable=True)
    def switch_off(self) -> Activity:
        """Switch all lights off."""
        return self._send(self.dark)

    @request("power_colour", _LEVEL)
    def power_colour(self) -> int:
        """Return the power light's colour, from 0 green to 255 red."""
        return int(self.lights.power_colour)

    @request("power_intensity", _LEVEL)
    def power_intensity(self) -> int:
        """Return the power light's intensity, from 0 off to 255 full."""
        return int(self.lights.power_intensity)

    def show(self, **changes: Any) -> Activity:
        """Change some of the lights."""
        return self._send(replace(self.lights, **changes))

    def _send(self, lights: Any) -> Activity:
        yield from self._roomba.command(lights.encode())
        self.lights = lights


class _SciLights:
    """The lights that only a Roomba 4xx has. A base class of its own lists them before the power light."""

    set_dirt = _switch("dirt", "the dirt light")
    set_max = _switch("max", "the light of MAX")
    set_clean = _switch("clean", "the light of CLEAN")
    set_spot = _switch("spot", "the light of SPOT")
    dirt = _is_on("dirt", "the dirt light")
    max = _is_on("max", "the light of MAX")
    clean = _is_on("clean", "the light of CLEAN")
    spot = _is_on("spot", "the light of SPOT")

    @command("status", _STATUS, repeatable=True)
    def set_status(self: Any, colour: str) -> Activity:
        """Set the status light."""
        activity: Activity = self.show(status=StatusLed[colour.upper()])
        return activity

    @request("status", _STATUS)
    def status(self: Any) -> str:
        """Return the status light's colour."""
        return StatusLed(self.lights.status).name.lower()


class SciLeds(RoombaLeds, _SciLights):
    """The lights on the robot; requests return their last settings."""

    dark = SciLights()


class _OiLights:
    """The lights that only a Roomba with the Open Interface has."""

    set_debris = _switch("debris", "the debris light")
    set_spot = _switch("spot", "the light of SPOT")
    set_dock = _switch("dock", "the light of DOCK")
    set_check_robot = _switch("check_robot", "the light that asks for a check of the robot")
    debris = _is_on("debris", "the debris light")
    spot = _is_on("spot", "the light of SPOT")
    dock = _is_on("dock", "the light of DOCK")
    check_robot = _is_on("check_robot", "the light that asks for a check of the robot")


class OiLeds(RoombaLeds, _OiLights):
    """The lights on the robot; requests return their last settings."""

    dark = OiLights()


def _is_pressed(name: str) -> Callable[[Any], EALData]:
    """Return the request for the state of a button."""

    @request(name, _FLAG, description=f"Return whether {name.upper()} is pressed.")
    def is_pressed(self: RoombaButtons) -> EALData:
        return self.answer(lambda sees: name in sees.pressed)

    return is_pressed


class RoombaButtons(RoombaSensor):
    """Whether any button on the robot is pressed."""

    value = _FLAG

    def get_value(self) -> EALData:
        """Return whether any of them is pressed now."""
        return self.answer(lambda sees: bool(sees.pressed))


class SciButtons(RoombaButtons):
    """Whether any button on the robot is pressed."""

    max, clean, spot, power = map(_is_pressed, ("max", "clean", "spot", "power"))


class OiButtons(RoombaButtons):
    """Whether any button on the robot is pressed."""

    clean, spot, dock = map(_is_pressed, ("clean", "spot", "dock"))
    day, hour, minute, schedule, clock = map(_is_pressed, ("day", "hour", "minute", "schedule", "clock"))


class RoombaSong(SongBook):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    places = sci.SONGS
    """Number of songs that the Roomba stores; others are sent before they are played."""

    def __init__(self, roomba: RoombaDriver) -> None:
        super().__init__()
        self._roomba = roomba
        self._stored: dict[int, int] = {}
        self._plays_until_s = roomba.clock.now()

    @override
    def remaining_s(self) -> float:
        return self._plays_until_s - self._roomba.clock.now()

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    @command("notes", NOTES, repeatable=True)
    def set_notes(self, text: str) -> Activity:
        """Store the song's notes, at most 16."""
        notes = parse_notes(text)
        return self._store(text, notes)

    @command("play")
    def play(self) -> Activity:
        """Begin to play the song."""
        return self._begin(self._number, self.playable_notes())

    def _store(self, text: str, notes: list[tuple[int, int]]) -> Activity:
        number = self._number
        yield from self._send_song(number, notes)
        self._songs[number] = text

    def _begin(self, number: int, notes: list[tuple[int, int]]) -> Activity:
        if self._stored.get(number % self.places) != number:
            yield from self._send_song(number, notes)
        yield from self._roomba.command(sci.play(number % self.places))
        self._plays_until_s = self._roomba.clock.now() + duration_s(notes)

    def _send_song(self, number: int, notes: list[tuple[int, int]]) -> Activity:
        yield from self._roomba.command(sci.song(number % self.places, notes))
        self._stored[number % self.places] = number


class OiSong(RoombaSong):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    places = oi.SONGS
