"""The emulators of a fleet's open devices in one simulated world: a process of `eal lab`.

    python -m eal_actors.cli.lab_world FLEET

Each device has its own wire. The robots see and push each other, and the cameras above the floor see them. The first
line of the output is JSON: the values of the fleet file's variables, and the robots' poses. When stdin closes, the
program prints the robots' poses again, and ends.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

from eal_actors.cli.emulators import LabDevice, LabPose, devices_of, load_marked
from eal_actors.device.emulator_wires import WIRES, EmulatorWire
from eal_actors.device.plugin_context import FleetServices, PluginContext
from eal_actors.facade.robot_starter import RobotStarter
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import PluginError
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.manifest import discover
from eal_actors.managers.plugins import import_plugin


def main(fleet: Path) -> None:
    """Serve the wires until stdin closes."""
    threading.excepthook = _end_process
    config = load_marked(fleet)
    devices = sorted((device for device in devices_of(config) if device.is_in_world), key=lambda device: device.robot)
    clock = SystemClock()  # REAL_TIME begins with the machine's start: batteries of the world would be hours old
    scheme, services = _scheme(config, devices), RobotStarter(config, clock).services
    with ExitStack() as stack:
        wires: list[tuple[str, EmulatorWire]] = []
        addresses: dict[str, str] = {}
        for device in devices:
            wire = _wire(device, services, scheme)
            stack.callback(wire.close)
            wire.plug_in()
            addresses |= device.addresses(wire.address)
            wires.append((device.robot, wire))
        _print({"addresses": addresses, "poses": _poses(wires)})
        while os.read(sys.stdin.fileno(), 1):
            pass
        _print(_poses(wires))


def _wire(device: LabDevice, services: FleetServices, scheme: str) -> EmulatorWire:
    section = device.section
    module = importlib.import_module(f"{import_plugin(device.plugin).__package__}.{section.module}")
    context = PluginContext(device.robot, device.plugin.name, device.settings, services)
    url = f"{scheme}://world/{device.part or device.robot}"

    return WIRES[section.world_wire or ""](lambda: module.emulate_in_world(context, url))


def _scheme(config: FleetConfig, devices: list[LabDevice]) -> str:
    """Return the URL scheme of the plugin that simulates the devices' robots."""
    manifests, _ = discover(config.plugin_dirs)
    for device in devices:
        if (twin := device.plugin.file.twin) is not None and (simulation := manifests[twin.plugin].file.simulation):
            return simulation.scheme or twin.plugin
    raise PluginError("no plugin simulates the world of these devices: none of their manifests has a `twin`")


def _poses(wires: list[tuple[str, EmulatorWire]]) -> dict[str, LabPose]:
    """Return the poses of the robots; other devices have none."""
    poses = {}
    for robot, wire in wires:
        if (pose := getattr(wire.emulator, "pose", None)) is not None:
            x_m, y_m, yaw_rad = pose
            poses[robot] = x_m, y_m, math.degrees(math.remainder(yaw_rad, math.tau))
    return poses


def _print(content: object) -> None:
    sys.stdout.write(f"{json.dumps(content)}\n")
    sys.stdout.flush()


def _end_process(error: threading.ExceptHookArgs) -> None:
    """End the process when an emulator fails: a driver would only see silence."""
    threading.__excepthook__(error)
    os._exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
