"""Calibration files: one for each robot, beside the fleet file, which includes it.

The fleet file belongs to its author, so it is edited as text: one include is added, and everything else stays the same.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors.device.differential_base import WheelCalibration
from eal_actors.kernel.bundled import is_installed
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.kernel.yaml_tree import MarkedDict
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig, RobotConfig
from eal_actors.managers.plugins import EALPluginManager

KEY: Final = "calibration"
"""Setting of a plugin whose base can be calibrated."""

_TEXT: Final = """\
{comment}
version: 1
robots:
  {robot}:
    plugins:
      {instance}:
        {key}: {{track_factor: {calibration.track_factor:.6f}, wheel_ratio: {calibration.wheel_ratio:.6f}}}
"""


@dataclass(frozen=True, slots=True)
class WrittenCalibration:
    """A written calibration file, and whether the fleet file got a new include."""

    file: Path
    includes: bool


def write_calibration(
    fleet: FleetConfig, robot: str, calibration: WheelCalibration, comment: str
) -> WrittenCalibration:
    """Write a robot's calibration file beside the fleet file, and include it there.

    Raises:
        ConfigError: a file cannot be written or is bundled with the framework, or the changed fleet would be invalid or
            would not use the calibration. Both files are unchanged then.
    """
    require_own(fleet)
    instance = _instance(fleet.robots[robot], fleet)
    file = fleet.source.with_name(f"{fleet.source.stem}-{robot}.calibration.yaml")
    lines = "\n".join(f"# {line}".rstrip() for line in comment.splitlines())
    text = _TEXT.format(comment=lines, robot=robot, instance=instance, key=KEY, calibration=calibration)
    before, fleet_before = _read_text(file), _read_text(fleet.source) or ""
    included = with_include(fleet_before, str(fleet.source), file.name)
    try:
        _replace_file(file, text)
        if included != fleet_before:
            _replace_file(fleet.source, included)
        _require_used(fleet.source, robot, instance, text, file)
    except BaseException:
        _restore(file, before)
        _restore(fleet.source, fleet_before)
        raise
    return WrittenCalibration(file, includes=included != fleet_before)


def require_own(fleet: FleetConfig) -> None:
    """Raise ConfigError if the fleet file is part of the installed framework."""
    if is_installed(fleet.source):
        name = fleet.source.stem
        message = (
            "is part of the framework and is not changed: write your own fleet file "
            f"with `include: [{name}]` below `version: 1`, and calibrate with that"
        )
        raise ConfigError([Problem(str(fleet.source), 0, 0, "", message)])


def with_include(text: str, name: str, include: str) -> str:
    """Return a fleet file's text with one more include after all others, otherwise unchanged.

    Args:
        text: text of a valid fleet file.
        name: name of the file in error messages.
        include: the file to include.

    Raises:
        ConfigError: the layout of the file allows no automatic change.
    """
    root = parse_yaml(text, name).root
    known = root.get("include")
    if known is not None and include in known:
        return text
    lines = f"{text}{'' if text.endswith(chr(10)) else chr(10)}".splitlines(keepends=True)
    if not known:
        if known is None:
            mark = root.value_marks["version"]
            lines.insert(mark.line, f"include: [{include}]\n")
        new = "".join(lines)
    else:
        mark = known.marks[-1]
        line = lines[mark.line - 1]
        lead = line[: mark.column - 1]
        if lead.strip() == "-":
            lines.insert(mark.line, f"{lead}{include}\n")
        else:
            end = line.find("]", mark.column - 1)
            lines[mark.line - 1] = f"{line[:end]}, {include}{line[end:]}" if end > 0 else line
        new = "".join(lines)
    _require_only_included(root, new, name, include)
    return new


def _require_only_included(before: MarkedDict, new: str, name: str, include: str) -> None:
    """Raise ConfigError unless a text has the former content and one include more."""
    wanted: dict[str, Any] = {**before, "include": [*(before.get("include") or ()), include]}
    try:
        is_so = parse_yaml(new, name).root == wanted
    except ConfigError:
        is_so = False
    if not is_so:
        message = f"cannot be changed automatically: add {include} to the end of its list, then try again"
        raise ConfigError([Problem(name, 0, 0, "include", message)])


def _instance(robot: RobotConfig, fleet: FleetConfig) -> str:
    """Return the instance name of the plugin that provides the robot's base."""
    manifests = EALPluginManager(fleet.plugin_dirs).manifests
    for name, settings in robot.plugins.items():
        if settings.plugin in manifests and "Base" in manifests[settings.plugin].file.resources:
            return name
    raise ConfigError(
        [
            Problem(
                str(fleet.source),
                0,
                0,
                f"robots.{robot.name}.plugins",
                f"has no plugin with a Base: put '{KEY}' into the fleet file that serves the robot",
            )
        ]
    )


def _require_used(source: Path, robot: str, instance: str, text: str, file: Path) -> None:
    """Raise ConfigError unless the fleet file is valid and gives the robot the calibration of the file."""
    manager = EALConfigManager.load(source)
    config = manager.robot(robot)
    problems, _ = EALPluginManager(manager.fleet.plugin_dirs).check(config)
    if problems:
        raise ConfigError(sorted(problems))
    wanted = parse_yaml(text, str(file)).root["robots"][robot]["plugins"][instance][KEY]
    settings: Mapping[str, Any] = config.plugins[instance].settings
    if settings[KEY] != wanted:
        message = "is set here and would override the measured calibration: remove it, then try again"
        raise ConfigError([config.plugins[instance].problem((KEY,), message)])


def _read_text(file: Path) -> str | None:
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unwritable(file, error) from error


def _restore(file: Path, text: str | None) -> None:
    if text is None:
        file.unlink(missing_ok=True)
    elif _read_text(file) != text:
        _replace_file(file, text)


def _replace_file(file: Path, text: str) -> None:
    """Replace a file atomically, keeping its permissions."""
    trial = file.with_name(f".{file.name}.new")
    try:
        trial.write_text(text, encoding="utf-8")
        if file.exists():
            trial.chmod(file.stat().st_mode & 0o777)
        trial.replace(os.path.realpath(file))
    except OSError as error:
        with suppress(OSError):
            trial.unlink(missing_ok=True)
        raise _unwritable(file, error) from error


def _unwritable(file: Path, error: OSError) -> ConfigError:
    return ConfigError([Problem(str(file), 0, 0, "", f"cannot be written: {error.strerror}")])
