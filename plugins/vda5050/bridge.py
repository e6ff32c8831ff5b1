"""The fleet as AGVs: each robot with a base that drives to places takes the orders of another master."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final, Self

from eal_actors import EALData, Fleet, ResourceHandle, RobotHandle
from eal_actors.facade.latecomers import Latecomers
from eal_actors.plugin import get_logger
from eal_actors.recording.sampler import Sampler, SampleSpec

from .order_driver import BASE
from .settings import BridgeSettings
from .vehicle import FleetVehicle

__all__ = ["BridgeSettings"]

_TICK_S: Final = 0.02
_BATTERY_S: Final = 1.0


@contextmanager
def open_bridge(fleet: Fleet, settings: BridgeSettings) -> Iterator[str]:
    """Connect an open fleet; yields what it does, for people.

    Raises:
        PluginError: a certificate or the password cannot be read.
    """
    latecomers = Latecomers(fleet)
    with _Vehicles(fleet, settings) as vehicles:
        vehicles.add(latecomers.present)
        first = list(vehicles.by_name.values())
        with vehicles.stepping(latecomers):
            for vehicle in first:
                vehicle.await_broker()
            problem = next((why for one in first if (why := one.why_not_ready())), None)
            topics = f"{settings.interface}/v2/{settings.manufacturer}"
            yield f"{len(first)} AGVs at {settings.broker}, topics {topics}/ROBOT" + (f"; {problem}" if problem else "")


class _Vehicles:
    """The AGVs of a bridge, by their robots' names; the end of its `with` block halts them."""

    def __init__(self, fleet: Fleet, settings: BridgeSettings) -> None:
        self._clock = fleet.clock
        self._settings = settings
        self._samplers = ExitStack()
        self.by_name: dict[str, FleetVehicle] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._samplers:  # their ends wait for robots that are lost
            for vehicle in self.by_name.values():
                vehicle.close()

    def add(self, robots: Sequence[RobotHandle]) -> None:
        """Make AGVs of robots. Thread: the one that steps them, or before."""
        if left_out := sorted(robot.name for robot in robots if not _drives(robot)):
            text = "these robots are no AGVs: they have no Pose, or no Base that knows goto"
            get_logger().warning(text, robots=left_out)
        specs = []
        for robot in filter(_drives, robots):
            self.by_name[robot.name] = FleetVehicle(robot, self._settings, self._clock)
            specs.append(SampleSpec(robot["Pose"], 1.0 / self._settings.visualization_rate_hz))
            if "Battery" in robot:
                specs.append(SampleSpec(robot["Battery"], _BATTERY_S))
        self._samplers.enter_context(Sampler(self._clock, specs, self._keep))

    def _keep(self, resource: ResourceHandle, data: EALData) -> bool:
        self.by_name[resource.robot].take_value(resource.name, data)
        return True

    @contextmanager
    def stepping(self, latecomers: Latecomers) -> Iterator[None]:
        """Step the AGVs in a thread, which also takes in the latecomers."""
        end = threading.Event()

        def run() -> None:
            while not end.wait(_TICK_S):
                latecomers.take_in(self.add)
                for name, vehicle in self.by_name.items():
                    try:
                        vehicle.step()
                    except Exception:  # noqa: BLE001  # one robot's failure must not stop the others
                        get_logger(robot=name).exception("the vehicle is halted")
                        vehicle.fail()

        thread = threading.Thread(target=run, name="vda5050 vehicles", daemon=True)
        thread.start()
        try:
            yield
        finally:
            end.set()
            thread.join()


def _drives(robot: RobotHandle) -> bool:
    return BASE in robot and "Pose" in robot and any(one.name == "goto" for one in robot[BASE].info.commands)
