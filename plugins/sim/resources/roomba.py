"""The buttons, lights and songs of a simulated Roomba. They have the interface of the real robot's resources."""

from __future__ import annotations

from typing import Any

from typing_extensions import override

from eal_actors.plugin import command

from ...roomba.lights import RoombaLights, SciSwitches
from ...roomba.sci import SciLights
from ...roomba.senses import SciButtonSensor
from ...roomba.songs import NOTES, SongBook, duration_s, parse_notes
from ..robot import SimRobot
from ..world import SimWorld
from .robot_resource import RobotResource


class Buttons(RobotResource, SciButtonSensor):
    """Whether any button on the robot is pressed."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self._sense(lambda _: (False,) * len(self.buttons))  # nobody presses them


class Leds(RobotResource, RoombaLights, SciSwitches):
    """The lights on the robot; requests return their last settings."""

    dark = SciLights()

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self.lights = self.dark

    @override
    def send(self, lights: Any) -> None:
        self.lights = lights


class Song(SongBook, RobotResource):
    """Plays songs of notes; get_status: 0 is silent, 1 plays."""

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        SongBook.__init__(self)
        RobotResource.__init__(self, world, robot)
        self._plays_until_s = 0.0

    @override
    def remaining_s(self) -> float:
        with self._world.lock:
            now_s = self._world.catch_up()
            return self._plays_until_s - now_s

    @command("notes", NOTES, repeatable=True)
    def set_notes(self, text: str) -> None:
        """Store the song's notes, at most 16."""
        parse_notes(text)
        self._songs[self.number] = text

    @command("play")
    def play(self) -> None:
        """Begin to play the song."""
        notes = self.playable_notes()
        with self._world.lock:
            now_s = self._world.catch_up()
            self._plays_until_s = now_s + duration_s(notes)
