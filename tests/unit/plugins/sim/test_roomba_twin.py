"""A simulated Roomba says of itself, and does, what the driver of a real one does."""

from __future__ import annotations

from typing import Any

import pytest

from eal_actors.kernel.errors import EALError
from eal_actors.plugin import EALData, FleetServices, PluginContext, Resource
from plugins.roomba import plugin as driver
from plugins.sim import plugin as sim
from tests.manual_clock import ManualClock
from tests.unit.plugins.roomba.rig import Rig

NAMES = ("Base", "Bump", "Cliff", "WheelDrop", "Wall", "Battery", "Odometry", "Buttons", "Leds", "Song")


class Pair:
    """The same resource of a driven and of a simulated Roomba."""

    def __init__(self, name: str) -> None:
        self.rig = Rig()
        self.clock = ManualClock()
        settings = sim.Settings.model_validate({"model": "roomba"})
        context = PluginContext("rob", "twin", settings, FleetServices(self.clock))
        self.driven = driver.RoombaPlugin(context, self.rig.roomba).makers[name]()
        self.simulated = sim.connect(context).makers[name]()
        self.driven.name = self.simulated.name = name

    def wait(self, duration_s: float) -> None:
        self.rig.wait(duration_s)
        self.clock.advance(duration_s)

    def call(self, method: str, *arguments: Any) -> list[Any]:
        """Call both and return what each answers, or why not."""
        return [self._outcome(resource, method, *arguments) for resource in (self.driven, self.simulated)]

    def _outcome(self, resource: Resource, method: str, *arguments: Any) -> Any:
        try:
            result = getattr(resource, method)(*arguments)
            return self.rig.run(result) if hasattr(result, "send") else result
        except EALError as error:
            return type(error), error.message


@pytest.mark.parametrize("name", NAMES)
def test_it_says_the_same_of_itself(name: str) -> None:
    pair = Pair(name)
    assert pair.simulated.info() == pair.driven.info()


def test_the_driver_has_nothing_that_is_not_compared() -> None:
    context = PluginContext("rob", "roomba", None, FleetServices(ManualClock()))
    names = driver.RoombaPlugin(context, Rig(awake=False).roomba).list_resources()
    assert set(names) == {*NAMES, "Power", "Pose"}  # one is about the hardware, the other is the framework's own


LEDS: list[tuple[Any, ...]] = [
    ("send_cmd", "dirt", EALData.of(True)),
    ("send_cmd", "max", EALData.of(True)),
    ("send_cmd", "clean", EALData.of(True)),
    ("send_cmd", "spot", EALData.of(True)),
    ("send_cmd", "status", EALData.of("red")),
    ("send_cmd", "status", EALData.of("blue")),
    ("send_cmd", "power_colour7"),
    ("send_cmd", "power_intensity300"),
    ("halt",),
    *(("send_req", name) for name in ("dirt", "max", "clean", "spot", "status", "power_colour", "power_intensity")),
    ("send_cmd", "off"),
    *(("send_req", name) for name in ("dirt", "max", "clean", "spot", "status", "power_colour", "power_intensity")),
]

SONG: list[tuple[Any, ...]] = [
    ("send_cmd", "play"),
    ("send_req", "notes"),
    ("send_cmd", "notes", EALData.of("60:32 62:x")),
    ("send_cmd", "notes", EALData.of("60:32 62:32")),
    ("set_config", "number", EALData.of(4)),
    ("get_config", "number"),
    ("send_req", "notes"),
    ("set_config", "number", EALData.of(0)),
    ("send_cmd", "play"),
    ("get_status",),
    ("halt",),
    ("send_cmd", "play"),
    ("wait", 0.99),
    ("get_status",),
    ("wait", 0.02),
    ("get_status",),
    ("send_cmd", "play"),
]


@pytest.mark.parametrize(("name", "calls"), [("Leds", LEDS), ("Song", SONG)])
def test_it_does_the_same(name: str, calls: list[tuple[Any, ...]]) -> None:
    pair = Pair(name)
    for method, *arguments in calls:
        if method == "wait":
            pair.wait(*arguments)
            continue
        driven, simulated = pair.call(method, *arguments)
        assert simulated == driven, f"{method} {arguments}"


def test_nobody_presses_the_buttons_of_either() -> None:
    pair = Pair("Buttons")
    assert [answer.value for answer in pair.call("get_value")] == [False, False]
    for name in ("max", "clean", "spot", "power"):
        assert [answer.value for answer in pair.call("send_req", name)] == [False, False]
