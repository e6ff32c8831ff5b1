"""The fleet as AGVs: each robot with a base that drives to places takes the orders of another master."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from eal_actors import EALData, Fleet, ResourceHandle, RobotHandle
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
    vehicles = {robot.name: FleetVehicle(robot, settings, fleet.clock) for robot in fleet.values() if _drives(robot)}
    absent = {robot.name for robot in fleet.values() if not list(robot)}
    if absent:
        text = "these robots are absent, so they are no AGVs: start the bridge again when they are there"
        get_logger().warning(text, robots=sorted(absent))
    if left_out := sorted(set(fleet) - set(vehicles) - absent):
        get_logger().warning("these robots are no AGVs: they have no Pose, or no Base that knows goto", robots=left_out)
    specs = []
    for name in vehicles:
        specs.append(SampleSpec(fleet[name]["Pose"], 1.0 / settings.visualization_rate_hz))
        if "Battery" in fleet[name]:
            specs.append(SampleSpec(fleet[name]["Battery"], _BATTERY_S))

    def keep(resource: ResourceHandle, data: EALData) -> bool:
        vehicles[resource.robot].take_value(resource.name, data)
        return True

    end = threading.Event()

    def run() -> None:
        while not end.wait(_TICK_S):
            for name, vehicle in vehicles.items():
                try:
                    vehicle.step()
                except Exception:  # noqa: BLE001  # one robot's failure must not stop the others
                    get_logger(robot=name).exception("the vehicle is halted")
                    vehicle.fail()

    thread = threading.Thread(target=run, name="vda5050 vehicles", daemon=True)
    try:
        with Sampler(fleet.clock, specs, keep):
            thread.start()
            for vehicle in vehicles.values():
                vehicle.await_broker()
            problem = next((why for one in vehicles.values() if (why := one.why_not_ready())), None)
            topics = f"{settings.interface}/v2/{settings.manufacturer}"
            yield f"{len(vehicles)} AGVs at {settings.broker}, topics {topics}/ROBOT" + (
                f"; {problem}" if problem else ""
            )
    finally:
        end.set()
        if thread.is_alive():
            thread.join()
        for vehicle in vehicles.values():
            vehicle.close()


def _drives(robot: RobotHandle) -> bool:
    return BASE in robot and "Pose" in robot and any(one.name == "goto" for one in robot[BASE].info.commands)
