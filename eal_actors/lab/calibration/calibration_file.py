"""Calibrations where the fleet file finds them: a file for each robot, beside the fleet file, which includes it."""

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
"""The setting of a plugin with a base that can be calibrated."""

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
class Written:
    """What was written.

    Attributes:
        file: the robot's calibration.
        includes: whether the fleet file was changed, to include it; otherwise it did already.
    """

    file: Path
    includes: bool


def write_calibration(fleet: FleetConfig, robot: str, calibration: WheelCalibration, comment: str) -> Written:
    """Write a robot's calibration beside the fleet file, and have that include it; its own text stays as it is.

    Args:
        fleet: as it was read from its file.
        robot: the robot's name.
        calibration: what was found.
        comment: told at the file's head.

    Raises:
        ConfigError: a file cannot be written or is the framework's, or the fleet would not be valid with it, or would
            not heed it. Both files are as before then.
    """
    require_own(fleet)
    instance = _instance(fleet.robots[robot], fleet)
    file = fleet.source.with_name(f"{fleet.source.stem}-{robot}.calibration.yaml")
    lines = "\n".join(f"# {line}".rstrip() for line in comment.splitlines())
    text = _TEXT.format(comment=lines, robot=robot, instance=instance, key=KEY, calibration=calibration)
    before, fleet_before = _text_of(file), _text_of(fleet.source) or ""
    included = with_include(fleet_before, str(fleet.source), file.name)
    try:
        _write(file, text)
        if included != fleet_before:
            _write(fleet.source, included)
        _require_heeded(fleet.source, robot, instance, text, file)
    except BaseException:
        _restore(file, before)
        _restore(fleet.source, fleet_before)
        raise
    return Written(file, includes=included != fleet_before)


def require_own(fleet: FleetConfig) -> None:
    """Raise ConfigError if the fleet file came with the installed framework."""
    if is_installed(fleet.source):
        name = fleet.source.stem
        message = (
            "comes with the framework and stays as it is: write a fleet file of your own "
            f"that builds on it, with `include: [{name}]` below `version: 1`, and calibrate with that"
        )
        raise ConfigError([Problem(str(fleet.source), 0, 0, "", message)])


def with_include(text: str, name: str, include: str) -> str:
    """Return a fleet file's text that includes a further file after all others, with all else as it was.

    Args:
        text: of the fleet file, which is sound.
        name: what problems call it.
        include: the file to include.

    Raises:
        ConfigError: it is written in a way that only a person can change.
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
    """Raise ConfigError unless a text says what it said before, and includes one file more."""
    wanted: dict[str, Any] = {**before, "include": [*(before.get("include") or ()), include]}
    try:
        is_so = parse_yaml(new, name).root == wanted
    except ConfigError:
        is_so = False
    if not is_so:
        message = f"add {include} to the end of its list by hand, so that the file keeps its form, then try again"
        raise ConfigError([Problem(name, 0, 0, "include", message)])


def _instance(robot: RobotConfig, fleet: FleetConfig) -> str:
    """Return the name of the robot's plugin that has its base."""
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
                f"no plugin with a Base is named for it here: put '{KEY}' into the file that it is served with",
            )
        ]
    )


def _require_heeded(source: Path, robot: str, instance: str, text: str, file: Path) -> None:
    """Raise ConfigError unless the fleet file can be read, and gives the robot the calibration of the file."""
    manager = EALConfigManager.load(source)
    config = manager.robot(robot)
    problems, _ = EALPluginManager(manager.fleet.plugin_dirs).check(config)
    if problems:
        raise ConfigError(sorted(problems))
    wanted = parse_yaml(text, str(file)).root["robots"][robot]["plugins"][instance][KEY]
    settings: Mapping[str, Any] = config.plugins[instance].settings
    if settings[KEY] != wanted:
        message = "stands here already and would override what was measured: remove it, then try again"
        raise ConfigError([config.plugins[instance].problem((KEY,), message)])


def _text_of(file: Path) -> str | None:
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unwritable(file, error) from error


def _restore(file: Path, text: str | None) -> None:
    if text is None:
        file.unlink(missing_ok=True)
    elif _text_of(file) != text:
        _write(file, text)


def _write(file: Path, text: str) -> None:
    """Write a file as a whole or not at all, with the permissions it has."""
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
