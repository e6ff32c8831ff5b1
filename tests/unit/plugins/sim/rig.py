"""Robots of the sim plugin on a clock that stands still between commands."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from eal_actors.device.world import WorldModel
from eal_actors.plugin import FleetServices, PluginContext, Resource
from plugins.sim import plugin as sim
from tests.manual_clock import ManualClock

TICK_S = 0.02


def arena(
    width_m: float = 6.0, height_m: float = 4.0, obstacles: Iterable[dict[str, Any]] = (), **parts: Any
) -> WorldModel:
    fields = {"version": 1, "name": "arena", "size_m": (width_m, height_m), "obstacles": tuple(obstacles), **parts}
    return WorldModel.model_validate(fields)


class Fleet:
    """Robots of the sim plugin on one clock that stands still between commands."""

    def __init__(self, world: WorldModel | None = None, seed: int = 1) -> None:
        self.clock = ManualClock()
        self.services = FleetServices(self.clock, seed, world)

    def add(self, name: str, start: tuple[float, float, float] | None = None, **settings: Any) -> Robot:
        place = dict(zip(("x_m", "y_m", "yaw_deg"), start, strict=True)) if start else None
        checked = sim.Settings.model_validate({"model": "roomba", "noise": False, "start": place, **settings})
        context = PluginContext(name, "sim", checked, self.services)
        return Robot(self, context)

    def run(self, *activities: Any) -> list[Any]:
        """Step activities side by side until all are over, and return their results."""
        results: list[Any] = [None] * len(activities)
        running = dict(enumerate(activities))
        while running:
            waits = []
            for index, activity in list(running.items()):
                try:
                    waits.append(next(activity))
                except StopIteration as done:
                    results[index] = done.value
                    del running[index]
            if waits:
                assert min(waits) > 0
                self.clock.advance(min(waits))
        return results


class Robot:
    def __init__(self, fleet: Fleet, context: PluginContext) -> None:
        self.fleet = fleet
        self.plugin = sim.connect(context)
        self.context = context
        self.name = context.robot
        self.base: Any = self.resource("Base")
        self.pose_sensor: Any = self.resource("TruePose")

    def resource(self, name: str) -> Resource:
        """Make one of its resources."""
        return self.plugin.makers[name]()

    @property
    def pose(self) -> list[float]:
        values: list[float] = self.pose_sensor.get_value().value.tolist()
        return values

    def do(self, *commands: str) -> None:
        for text in commands:
            assert self.fleet.run(self.base.send_cmd(text)) == [1]
