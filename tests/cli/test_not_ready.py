"""A served robot without its device: controllers receive the reason, and continue when the device returns."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import NotReadyError
from eal_actors.managers.config import EALConfigManager
from tests.net.links import free_port

MANIFEST = """\
version: 1
name: thermometer
description: A thermometer.
plugin_version: "1"
resources: [Thermometer]
"""

PLUGIN = '''
"""A thermometer that exists while its file exists."""

from pathlib import Path

from eal_actors.plugin import EALPlugin, PluginContext, PluginSettingsModel, Resource, ResourceType


class Settings(PluginSettingsModel):
    file: str


class Thermometer(Resource):
    """Temperature."""

    types = ResourceType.SENSOR

    def __init__(self, file: Path) -> None:
        self.file = file

    def not_ready(self) -> str | None:
        return None if self.file.exists() else f"cannot open {self.file.name}: no such file"

    def get_value(self) -> int:
        return int(self.file.read_text())


def connect() -> EALPlugin:
    return EALPlugin("Thermometer")


def disconnect(plugin: EALPlugin) -> None:
    pass


def create_Thermometer(context: PluginContext) -> Thermometer:
    return Thermometer(Path(context.settings.file))


def destroy_Thermometer(resource: Thermometer) -> None:
    pass
'''


@pytest.fixture
def device(tmp_path: Path) -> Path:
    return tmp_path / "device"


@pytest.fixture
def fleet(tmp_path: Path, write: Any, device: Path) -> Iterator[Path]:
    """A fleet of one served robot."""
    write("plugins/thermometer/plugin.py", PLUGIN)
    write("plugins/thermometer/plugin.yaml", MANIFEST)
    file: Path = write(
        "fleet.yaml",
        f"""
        version: 1
        name: cold
        plugin_dirs: [plugins]
        robots:
          one:
            address: tcp/127.0.0.1:{free_port()}
            plugins: {{thermometer: {{file: {device}}}}}
        """,
    )
    with RobotService(EALConfigManager.load(file).fleet, "one"):
        yield file


def test_a_controller_learns_why_and_works_on_when_it_is_back(fleet: Path, device: Path) -> None:
    with Fleet.load(fleet).connect(["one"]) as controller:
        robot = controller["one"]
        assert robot.not_ready == {"Thermometer": "cannot open device: no such file"}
        with pytest.raises(NotReadyError, match="one/Thermometer: cannot open device: no such file"):
            robot["Thermometer"].get_value().get()
        device.write_text("21")
        assert robot["Thermometer"].get_value().get().value == 21
        assert robot.ping().get().not_ready == {}
        assert robot.not_ready == {}


def test_a_ping_shows_it(eal: Any, fleet: Path, device: Path) -> None:
    result = eal("ping", "--fleet", fleet, "--count", 1)
    assert result.exit_code == 0  # the robot itself is ready
    assert "one: Thermometer is not ready: cannot open device: no such file\n" in result.stdout
    (robot,) = json.loads(eal("ping", "--fleet", fleet, "--count", 1, "--json").stdout)["robots"]
    assert robot["not_ready"] == {"Thermometer": "cannot open device: no such file"}
