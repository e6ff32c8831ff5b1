"""The twin of a sensor: the driver itself, at a port of the simulated world."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.kernel.errors import PluginError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.manifest import read_manifest
from eal_actors.managers.twins import simulated
from eal_actors.plugin import PluginContext
from eal_actors.testing import Simulation
from tests.plugin_files import write_plugin

PROBE = """
from eal_actors.plugin import *

class Settings(PluginSettingsModel):
    port: str

class Probe(Resource):
    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "m")

    def __init__(self, context):
        self._port = context.simulated_port(context.settings.port, None, Emulator)

    def get_value(self):
        self._port.write(b"?")
        return float(self._port.read(10))

class Emulator:
    def __init__(self, body):
        self._body = body

    def feed(self, data, now_s):
        return b"%.1f" % self._body.pose[0] if data else b""

def create_Probe(context):
    return Probe(context)
"""


@pytest.mark.parametrize(
    "base", ["roomba: {protocol: sci, port: /dev/no-such-port}", "sim: {model: evbot3, start: {x_m: 1, y_m: 0}}"]
)
def test_a_sensor_has_a_twin_of_its_own_beside_that_of_the_base(tmp_path: Path, base: str) -> None:
    write_plugin(tmp_path, "probe", PROBE, "Probe")
    manifest = tmp_path / "plugins/probe/plugin.yaml"
    twin = {"plugin": "probe", "settings": {"port": "sim://world"}}
    manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"twin": twin}))
    (tmp_path / "room.yaml").write_text("version: 1\nname: room\nsize_m: [4, 4]\nstarts: [{x_m: 1, y_m: 0}]\n")
    file = tmp_path / "fleet.yaml"
    plugins = f"{{probe: {{port: /dev/no-such-port}}, {base}}}"
    file.write_text(f"version: 1\nplugin_dirs: [plugins]\nworld: room.yaml\nrobots:\n  a: {{plugins: {plugins}}}\n")
    twins = simulated(EALConfigManager.load(file).fleet, ["a"])
    assert list(twins.config.robots["a"].plugins) == ["sim", "probe"]
    assert "probe" in twins.replaced["a"]
    assert not twins.left_out
    assert read_manifest(manifest.parent).contradictions() == []
    with Fleet(twins.config) as fleet:
        assert fleet["a"]["Probe"].get_value().get().value == 1.0


def test_a_sensor_of_a_robot_that_is_not_in_the_world_says_so() -> None:
    with Simulation({"body": "roomba"}) as simulation:
        context = PluginContext("mate", "probe", None, simulation.fleet.services)
        with pytest.raises(PluginError, match="no robot 'mate' is in the simulated world yet"):
            context.simulated_port("sim://world", None, lambda body: body)
