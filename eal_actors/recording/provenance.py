"""The input of a run, kept in its folder: fleet, world and scenario files, and versions."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import yaml

from eal_actors.device.world import WorldModel, load_world
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario import Scenario

FLEET: Final = "fleet.yaml"
WORLD: Final = "world.yaml"
SCENARIO: Final = "scenario.yaml"
SCENARIOS: Final = "scenarios"
VERSIONS: Final = "versions.json"
_PACKAGES: Final = ("eal-actors", "eclipse-zenoh", "numpy", "opencv-python-headless", "pykka", "pymunk")
_PASSWORD: Final = re.compile(r"(?<=://)([^/@:\s]*):[^/@\s]+@")
_QUERY: Final = re.compile(r"(?<=://)([^\s?]+\?)\S+")
_SECRET_KEY: Final = re.compile(r"(.*_)?(passw(or)?d|pwd|passphrase|secret|token|api_?key|credentials?)", re.IGNORECASE)
_HIDDEN: Final = "***"


def keep_provenance(directory: Path, config: FleetConfig, scenario: Scenario) -> None:
    """Write the fleet with its includes, the world, the scenario and the versions into a run's folder.

    A scenario that runs others is written with them to a folder in which their relative paths are kept.

    Secrets are removed: passwords and queries of URLs, and settings with secret names such as `password` and
    `api_token`. Other files that the fleet file names, such as plugin folders, are not copied. Raises OSError if a file
    cannot be written.
    """
    (directory / FLEET).write_text(_as_yaml(resolved_fleet(config)), encoding="utf-8")
    if config.world is not None:
        world = config.world.model_dump(mode="json", exclude_none=True, exclude_defaults=True)
        (directory / WORLD).write_text(_as_yaml({"version": 1, **world}), encoding="utf-8")
    (directory / SCENARIO).write_text("\n".join(scenario.lines), encoding="utf-8", newline="")
    if scenario.parts:
        _keep_parts(directory / SCENARIOS, scenario)
    (directory / VERSIONS).write_text(json.dumps(versions(), indent=2) + "\n", encoding="utf-8")


def _keep_parts(folder: Path, scenario: Scenario) -> None:
    """Write a scenario and all that it runs, with their relative paths."""
    files: dict[Path, str] = {}
    waiting = [scenario]
    while waiting:
        one = waiting.pop()
        files[one.source.resolve()] = "\n".join(one.lines)  # as it was read
        waiting += one.parts.values()
    above = Path(os.path.commonpath([file.parent for file in files]))
    for file, text in files.items():
        kept = folder / file.relative_to(above)
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(text, encoding="utf-8", newline="")


def resolved_fleet(config: FleetConfig) -> dict[str, Any]:
    """Return the content of a fleet as one file, without includes and secrets."""
    content = {key: value for key, value in config.content.items() if key != "include"}
    content |= {"name": config.name, "seed": config.seed, "clock": {"rate": config.rate}}
    if config.world is not None:
        content["world"] = WORLD
    if config.map_path is not None:
        content["map"] = str(config.map_path.resolve())
    if config.plugin_dirs:
        content["plugin_dirs"] = [str(folder) for folder in config.plugin_dirs]
    return dict(_without_secrets(content))


def kept_scenario(directory: Path) -> Path:
    """Return the scenario of a run; if it runs others, the copy beside which they are."""
    scenario = directory / SCENARIO
    if not scenario.is_file():
        return scenario
    content = scenario.read_bytes()
    files = sorted(file for file in (directory / SCENARIOS).rglob("*") if file.is_file())
    return next((file for file in files if file.read_bytes() == content), scenario)


def kept_world(directory: Path) -> WorldModel | None:
    """Return the world of a run, or None if it had none; raise ConfigError if its file was changed and is invalid."""
    file = directory / WORLD
    return load_world(file) if file.is_file() else None


def versions() -> dict[str, str]:
    """Return the versions of Python, the system and the main packages, by name."""
    found = {"python": platform.python_version(), "system": f"{platform.system()} {platform.machine()}"}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def _without_secrets(value: Any, *, is_secret: bool = False) -> Any:
    if isinstance(value, Mapping):
        return {
            key: _without_secrets(item, is_secret=_SECRET_KEY.fullmatch(str(key)) is not None)
            for key, item in value.items()
        }
    if isinstance(value, list):
        return [_without_secrets(item, is_secret=is_secret) for item in value]
    if is_secret and value is not None:
        return _HIDDEN
    if isinstance(value, str):
        return _QUERY.sub(rf"\1{_HIDDEN}", _PASSWORD.sub(rf"\1:{_HIDDEN}@", value))
    return value


def _as_yaml(content: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=120)
