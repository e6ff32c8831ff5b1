"""The Roomba's panel: lights, songs and buttons. Each kind of Roomba has its own lights and buttons."""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from eal_actors.plugin import Activity, command

from . import oi, sci
from .driver import RoombaDriver
from .lights import OiSwitches, RoombaLights, SciSwitches
from .resources import RoombaResource, RoombaSensor
from .senses import FlagSensor, SciButtonSensor, pressed
from .songs import NOTES, SongBook, duration_s, parse_notes


class RoombaLeds(RoombaResource, RoombaLights):
    """The lights of a real Roomba."""

    def __init__(self, roomba: RoombaDriver) -> None:
        super().__init__(roomba)
        self.lights = self.dark

    @override
    def send(self, lights: Any) -> Activity:
        yield from self._roomba.command(lights.encode())
        self.lights = lights


class SciLeds(RoombaLeds, SciSwitches):
    """The lights on the robot; requests return their last settings."""

    dark = sci.SciLights()


class OiLeds(RoombaLeds, OiSwitches):
    """The lights on the robot; requests return their last settings."""

    dark = oi.OiLights()


class RoombaButtons(RoombaSensor, FlagSensor):
    """The buttons of a real Roomba."""

    buttons: tuple[str, ...]

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self.read(lambda sees: tuple(name in sees.pressed for name in self.buttons))


class SciButtons(RoombaButtons, SciButtonSensor):
    """Whether any button on the robot is pressed."""


class OiButtons(RoombaButtons):
    """Whether any button on the robot is pressed."""

    buttons = "clean", "spot", "dock", "day", "hour", "minute", "schedule", "clock"
    clean, spot, dock, day, hour, minute, schedule, clock = map(pressed, buttons, range(8))


class RoombaSong(RoombaResource, SongBook):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    places = sci.SONGS
    """Number of songs that the Roomba stores."""

    def __init__(self, roomba: RoombaDriver) -> None:
        SongBook.__init__(self)
        RoombaResource.__init__(self, roomba)
        self._plays_until_s = roomba.clock.now()

    @override
    def remaining_s(self) -> float:
        return self._plays_until_s - self._roomba.clock.now()

    @command("notes", NOTES, repeatable=True)
    def set_notes(self, text: str) -> Activity:
        """Store the song's notes, at most 16."""
        notes = parse_notes(text)
        return self._store(text, notes)

    @command("play")
    def play(self) -> Activity:
        """Begin to play the song."""
        return self._begin(self.number, self.playable_notes())

    def _store(self, text: str, notes: list[tuple[int, int]]) -> Activity:
        number = self.number
        yield from self._send_song(number, notes)
        self._songs[number] = text

    def _begin(self, number: int, notes: list[tuple[int, int]]) -> Activity:
        yield from self._send_song(number, notes)  # a Roomba that was switched off has lost it
        yield from self._roomba.command(sci.play(number % self.places))
        self._plays_until_s = self._roomba.clock.now() + duration_s(notes)

    def _send_song(self, number: int, notes: list[tuple[int, int]]) -> Activity:
        yield from self._roomba.command(sci.song(number % self.places, notes))


class OiSong(RoombaSong):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    places = oi.SONGS
