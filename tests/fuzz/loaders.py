"""Fuzz targets of file loaders: each refuses only with a ConfigError that names a position."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from pathlib import Path

from eal_actors.device.world import load_world
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.manifest import read_manifest
from eal_actors.scenario.language.expressions.evaluation import parse_bare
from eal_actors.scenario.language.expressions.grammar import parse_template
from eal_actors.scenario.language.loading import parse_scenario

ROOT = Path(__file__).parents[2]
_REFERENCE = re.compile(r"(file|map|include|world|plugin_dirs|scenario)")


def _yaml(data: bytes) -> None:
    for environment in (None, {"HOST": "10.0.0.1", "EMPTY": ""}):
        try:
            parse_yaml(data, "fuzz.yaml", environment=environment)
        except ConfigError as error:
            _placed(error)


def _placed(error: ConfigError) -> None:
    if not error.problems or any(problem.line < 0 or not problem.message for problem in error.problems):
        raise AssertionError(f"{error!r} says nothing")
    str(error)


def _read(data: bytes, name: str, load: Callable[[Path], object]) -> None:
    """Write a file into a folder of its own, and load it."""
    with tempfile.TemporaryDirectory(prefix="eal-fuzz-") as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        try:
            load(path)
        except ConfigError as error:
            _placed(error)


def _fleet(data: bytes) -> None:
    _read(data, "fleet.yaml", lambda path: EALConfigManager.load(path, environment={}))


def _world(data: bytes) -> None:
    _read(data, "world.yaml", load_world)


def _manifest(data: bytes) -> None:
    _read(data, "plugin.yaml", lambda path: read_manifest(path.parent))


def _scenario(data: bytes) -> None:
    try:
        parse_scenario(data.decode("utf-8", "surrogateescape"), "fuzz.yaml", folder=ROOT / "scenarios")
    except ConfigError as error:
        _placed(error)


def _expression(data: bytes) -> None:
    text = data.decode("utf-8", "replace")
    for parse in (parse_template, parse_bare):
        try:
            parse(text)
        except ValueError as error:
            if not str(error):
                raise AssertionError("it is refused without a reason") from error


LOADERS: dict[str, Callable[[bytes], None]] = {
    "yaml": _yaml,
    "fleet": _fleet,
    "world": _world,
    "scenario": _scenario,
    "manifest": _manifest,
    "expression": _expression,
}

SHIPPED: dict[str, str] = {
    "yaml": "fleets/*.yaml",
    "fleet": "fleets/*.yaml",
    "world": "fleets/worlds/*.yaml",
    "scenario": "scenarios/*.yaml",
    "manifest": "plugins/*/plugin.yaml",
}
"""Files that seed a target beside its corpus."""
