"""What the Roomba shows and sounds: lights and songs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DataType,
    Resource,
    ResourceType,
    UnavailableError,
    ValueInfo,
    command,
    config,
    config_setter,
    request,
)

from . import protocol
from .driver import RoombaDriver
from .protocol import StatusLed

_FLAG: Final = ValueInfo(DataType.BOOL)
_STATUS: Final = ValueInfo(DataType.CHAR, choices=("off", "red", "green", "amber"))
_LEVEL: Final = ValueInfo(DataType.INT, None, 0, 255)
_NUMBER: Final = ValueInfo(DataType.INT, None, 0, 15)
_NOTES: Final = ValueInfo(DataType.CHAR, description="MIDI notes 31..127, each with 1/64 s 1..255: 72:16 76:16 79:32")
_MOST_NOTES: Final = 16


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

    @command("dirt", _FLAG)
    def set_dirt(self, on: bool) -> Activity:
        """Switch the dirt light on or off."""
        return self._set(dirt=on)

    @command("max", _FLAG)
    def set_max(self, on: bool) -> Activity:
        """Switch the light of MAX on or off."""
        return self._set(max=on)

    @command("clean", _FLAG)
    def set_clean(self, on: bool) -> Activity:
        """Switch the light of CLEAN on or off."""
        return self._set(clean=on)

    @command("spot", _FLAG)
    def set_spot(self, on: bool) -> Activity:
        """Switch the light of SPOT on or off."""
        return self._set(spot=on)

    @command("status", _STATUS)
    def set_status(self, colour: str) -> Activity:
        """Set the status light."""
        return self._set(status=StatusLed[colour.upper()])

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
        return self._lights.status.name.lower()

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


class Song(Resource):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    places = protocol.SONGS
    """How many songs the Roomba itself keeps; the others are told to it before they are played."""

    types = ResourceType.ACTUATOR

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba
        self._number = 0
        self._songs: dict[int, str] = {}
        self._stored: dict[int, int] = {}
        self._plays_until_s = roomba.clock.now()

    def get_status(self) -> int:
        """Return 0 while it is silent, 1 while it plays."""
        return int(self._roomba.clock.now() < self._plays_until_s)

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    def halt(self) -> None:
        """Do nothing: a song moves nothing, and once begun it cannot be cut off."""

    @config("number", _NUMBER)
    def number(self) -> int:
        """Number of the song that the commands and the request use."""
        return self._number

    @config_setter("number")
    def set_number(self, number: int) -> None:
        """Select the song."""
        self._number = number

    @command("notes", _NOTES)
    def set_notes(self, text: str) -> Activity:
        """Store the song's notes, at most 16."""
        notes = _parsed(text)
        return self._store(text, notes)

    @command("play")
    def play(self) -> Activity:
        """Begin to play the song."""
        if self._number not in self._songs:
            raise ArgumentError(f"song {self._number} has no notes yet; the command notes sets them")
        left_s = self._plays_until_s - self._roomba.clock.now()
        if left_s > 0:
            raise UnavailableError(f"a song plays for another {left_s:.2f} s, and cannot be stopped")
        return self._begin()

    @request("notes", ValueInfo(DataType.CHAR))
    def notes(self) -> str:
        """Return the stored notes of the song; empty for none."""
        return self._songs.get(self._number, "")

    def _store(self, text: str, notes: list[tuple[int, int]]) -> Activity:
        number = self._number
        yield from self._tell(number, notes)
        self._songs[number] = text

    def _begin(self) -> Activity:
        number, notes = self._number, _parsed(self._songs[self._number])
        if self._stored.get(number % self.places) != number:
            yield from self._tell(number, notes)
        yield from self._roomba.command(protocol.play(number % self.places))
        length_s = sum(duration for _, duration in notes) / 64
        self._plays_until_s = self._roomba.clock.now() + length_s

    def _tell(self, number: int, notes: list[tuple[int, int]]) -> Activity:
        yield from self._roomba.command(protocol.song(number % self.places, notes))
        self._stored[number % self.places] = number


def _parsed(text: str) -> list[tuple[int, int]]:
    """Return the pairs of note and duration in 1/64 s that a text such as `72:16 76:32` names.

    Raises:
        ArgumentError: it is no such text, a number is outside its range, or there are too few or too many notes.
    """
    notes = []
    for word in text.split():
        note, _, duration = word.partition(":")
        if not (note.isdecimal() and duration.isdecimal() and 31 <= int(note) <= 127 and 1 <= int(duration) <= 255):
            raise ArgumentError(f"{word!r} is no note 31..127 with its 1/64 s 1..255, as in 72:16")
        notes.append((int(note), int(duration)))
    if not 1 <= len(notes) <= _MOST_NOTES:
        raise ArgumentError(f"a song has 1..{_MOST_NOTES} notes, not {len(notes)}")
    return notes
