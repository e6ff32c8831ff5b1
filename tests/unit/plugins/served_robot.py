"""A simulated robot that this process serves over the network."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from eal_actors.facade.service import RobotService
from eal_actors.managers.config import EALConfigManager
from tests.unit.plugins.ros2.rig import free_port


@contextmanager
def served_robot(folder: Path, name: str) -> Iterator[Path]:
    """Serve a robot; yield the fleet file, for its controllers."""
    robot = {"plugins": {"sim": {"model": "roomba"}}, "address": f"tcp/127.0.0.1:{free_port()}"}
    file = folder / "fleet.yaml"
    file.write_text(json.dumps({"version": 1, "name": "one", "robots": {name: robot}}))
    with RobotService(EALConfigManager.load(file).fleet, name):
        yield file
