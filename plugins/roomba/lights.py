"""The lights of a Roomba: the interface of a real and of a simulated one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, Final

from eal_actors.plugin import Activity, DataType, Resource, ResourceType, ValueInfo, command, request

from .oi import OiLights
from .sci import SciLights, StatusLed

_FLAG: Final = ValueInfo(DataType.BOOL)
_STATUS: Final = ValueInfo(DataType.CHAR, choices=("off", "red", "green", "amber"))
_LEVEL: Final = ValueInfo(DataType.INT, None, 0, 255)


def switch(name: str, light: str) -> Callable[[Any, bool], Activity | None]:
    """Return the command that switches a light."""

    @command(name, _FLAG, repeatable=True, description=f"Switch {light} on or off.")
    def change(self: RoombaLights, on: bool) -> Activity | None:
        return self.show(**{name: on})

    return change


def is_on(name: str, light: str) -> Callable[[Any], bool]:
    """Return the request for the state of a light."""

    @request(name, _FLAG, description=f"Return whether {light} is on.")
    def read(self: RoombaLights) -> bool:
        return bool(getattr(self.lights, name))

    return read


class RoombaLights(Resource):
    """The lights of a Roomba.

    Attributes:
        lights: the lights as they were set last.
    """

    types = ResourceType.ACTUATOR
    dark: ClassVar[SciLights | OiLights]
    """All lights off."""
    lights: Any

    def send(self, lights: Any) -> Activity | None:
        """Switch the lights, and set `lights`; an activity if that takes time."""
        raise NotImplementedError

    def show(self, **changes: Any) -> Activity | None:
        """Change some of the lights."""
        return self.send(replace(self.lights, **changes))

    def halt(self) -> None:
        """Do nothing: a light does not move."""

    @command("power_colour<level>", _LEVEL, repeatable=True)
    def set_power_colour(self, level: int) -> Activity | None:
        """Set the colour of the power light, from 0 green to 255 red."""
        return self.show(power_colour=level)

    @command("power_intensity<level>", _LEVEL, repeatable=True)
    def set_power_intensity(self, level: int) -> Activity | None:
        """Set the intensity of the power light, from 0 off to 255 full."""
        return self.show(power_intensity=level)

    @command("off", repeatable=True)
    def switch_off(self) -> Activity | None:
        """Switch all lights off."""
        return self.send(self.dark)

    @request("power_colour", _LEVEL)
    def power_colour(self) -> int:
        """Return the power light's colour, from 0 green to 255 red."""
        return int(self.lights.power_colour)

    @request("power_intensity", _LEVEL)
    def power_intensity(self) -> int:
        """Return the power light's intensity, from 0 off to 255 full."""
        return int(self.lights.power_intensity)


class SciSwitches:
    """The lights that only a Roomba 4xx has. A base class of its own lists them before the power light."""

    set_dirt = switch("dirt", "the dirt light")
    set_max = switch("max", "the light of MAX")
    set_clean = switch("clean", "the light of CLEAN")
    set_spot = switch("spot", "the light of SPOT")
    dirt = is_on("dirt", "the dirt light")
    max = is_on("max", "the light of MAX")
    clean = is_on("clean", "the light of CLEAN")
    spot = is_on("spot", "the light of SPOT")

    @command("status", _STATUS, repeatable=True)
    def set_status(self: Any, colour: str) -> Activity | None:
        """Set the status light."""
        activity: Activity | None = self.show(status=StatusLed[colour.upper()])
        return activity

    @request("status", _STATUS)
    def status(self: Any) -> str:
        """Return the status light's colour."""
        return StatusLed(self.lights.status).name.lower()


class OiSwitches:
    """The lights that only a Roomba with the Open Interface has."""

    set_debris = switch("debris", "the debris light")
    set_spot = switch("spot", "the light of SPOT")
    set_dock = switch("dock", "the light of DOCK")
    set_check_robot = switch("check_robot", "the light that asks for a check of the robot")
    debris = is_on("debris", "the debris light")
    spot = is_on("spot", "the light of SPOT")
    dock = is_on("dock", "the light of DOCK")
    check_robot = is_on("check_robot", "the light that asks for a check of the robot")
