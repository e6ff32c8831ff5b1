"""How long Fleet.connect waits for robots that start slowly, and what it says of those that do not."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.facade import connections
from eal_actors.kernel.bundled import bundled_path
from tests.log_lines import log_lines
from tests.plugin_files import write_plugin

CODE = """
from eal_actors.plugin import EALPlugin, PluginContext, PluginSettingsModel, Resource, ResourceType

class Settings(PluginSettingsModel):
    gate: str

class Base(Resource):
    types = ResourceType.SENSOR

    def get_value(self) -> float:
        return 1.0

def connect(context: PluginContext) -> EALPlugin:
    open(context.settings.gate).close()  # a pipe: waits until the other end is opened
    return EALPlugin("Base")
"""
NAMES = ("one", "two", "three")
WAIT_S = 30.0


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    """Yield a fleet whose robots come up when their gates are opened."""
    write_plugin(tmp_path, "gated", CODE, "Base")
    robots = {}
    for name in NAMES:
        os.mkfifo(tmp_path / name)
        robots[name] = {"plugins": {"gated": {"gate": str(tmp_path / name)}}}
    file = tmp_path / "fleet.yaml"
    file.write_text(json.dumps({"version": 1, "plugin_dirs": ["plugins"], "robots": robots}))
    fleet = Fleet.load(file)
    try:
        yield fleet
    finally:
        for name in NAMES:
            if fleet and fleet[name].state is RobotState.STARTING:
                open_gate(tmp_path, name)
        fleet.close()


def open_gate(folder: Path, name: str) -> None:
    (folder / name).open("w").close()


def test_each_late_robot_is_reported_with_the_time_that_it_had(fleet: Fleet) -> None:
    with log_lines() as log:
        fleet.connect(timeout_s=0.2)
    late = [json.loads(line) for line in log.getvalue().splitlines() if "robot is late" in line]
    assert [line["robot"] for line in late] == list(NAMES)
    assert all(float(line["reason"].split()[-2]) >= 0.2 for line in late), late


def test_a_robot_is_halted_while_another_fleet_connects(fleet: Fleet, tmp_path: Path) -> None:
    local = connections.acquire_fleet(bundled_path("fleets/local.yaml"))
    (robot,) = local.values()
    connections.add_connection(robot)
    connecting = threading.Thread(target=connections._acquire, args=("gated", lambda: fleet))
    connecting.start()
    open_gate(tmp_path, NAMES[0])  # from here on it waits for the other robots
    leaving = threading.Thread(target=connections.remove_connection, args=(robot,), daemon=True)
    leaving.start()
    leaving.join(WAIT_S)
    assert not leaving.is_alive()
    for name in NAMES[1:]:
        open_gate(tmp_path, name)
    connecting.join()
    connections.release_fleet(fleet)
    connections.release_fleet(local)


def test_the_wait_begins_anew_when_a_robot_is_up(fleet: Fleet, tmp_path: Path) -> None:
    """Together they take longer than the limit, as a thousand robots may."""

    def open_all() -> None:
        for name in NAMES:
            fleet.clock.sleep(0.7)
            open_gate(tmp_path, name)

    opening = threading.Thread(target=open_all)
    opening.start()
    with log_lines() as log:
        fleet.connect(timeout_s=1.4)
    opening.join()
    assert "robot is late" not in log.getvalue()
    assert all(robot.state is RobotState.READY for robot in fleet.values())
