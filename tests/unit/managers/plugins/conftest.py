"""Fixtures that write and load plugins."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.managers.plugins import EALPluginManager
from tests.unit.managers.plugins.rig import CODE, MANIFEST, Write


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a plugin's folder."""

    def write_plugin(
        name: str, code: str = CODE, *, resources: str = "Thing", under: str = "plugins", extra: str = ""
    ) -> Path:
        folder = tmp_path / under / name
        folder.mkdir(parents=True)
        text = MANIFEST.format(name=name, resources=resources) + extra
        (folder / "plugin.yaml").write_text(text, encoding="utf-8")
        (folder / "plugin.py").write_text(code, encoding="utf-8")
        return folder

    return write_plugin


@pytest.fixture
def manager(tmp_path: Path) -> Callable[[], EALPluginManager]:
    return lambda: EALPluginManager([tmp_path / "plugins"])


@pytest.fixture
def robot(tmp_path: Path) -> Callable[[str], RobotConfig]:
    """Return a robot with the plugins given as in a fleet file."""

    def make(plugins: str) -> RobotConfig:
        file = tmp_path / "fleet.yaml"
        file.write_text(f"version: 1\nrobots:\n  bot:\n    plugins: {plugins}\n", encoding="utf-8")
        return EALConfigManager.load(file, environment={}).fleet.robots["bot"]

    return make
