"""Calibration files: one for each robot, beside the fleet file, which includes it.

The fleet file belongs to its author, so it is edited as text: one include is added, and everything else stays the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors.device.differential_base import WheelCalibration
from eal_actors.kernel.errors import ConfigError, file_error
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.lab.fleet_edits import changed_files, read_text, require_own, with_include
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

    Raises ConfigError if a file cannot be written or is bundled with the framework, or the changed fleet would be
    invalid or would not use the calibration; both files are unchanged then.
    """
    require_own(fleet, "calibrate with that")
    instance = _instance(fleet.robots[robot], fleet)
    file = fleet.source.with_name(f"{fleet.source.stem}-{robot}.calibration.yaml")
    lines = "\n".join(f"# {line}".rstrip() for line in comment.splitlines())
    text = _TEXT.format(comment=lines, robot=robot, instance=instance, key=KEY, calibration=calibration)
    fleet_before = read_text(fleet.source) or ""
    included = with_include(fleet_before, str(fleet.source), file.name)
    with changed_files({file: text, fleet.source: included}):
        _require_used(fleet.source, robot, instance, text, file)
    return WrittenCalibration(file, includes=included != fleet_before)


def _instance(robot: RobotConfig, fleet: FleetConfig) -> str:
    """Return the instance name of the plugin that provides the robot's base."""
    manifests = EALPluginManager(fleet.plugin_dirs).manifests
    for name, settings in robot.plugins.items():
        if settings.plugin in manifests and "Base" in manifests[settings.plugin].file.resources:
            return name
    why = f"has no plugin with a Base: put '{KEY}' into the fleet file that serves the robot"
    raise file_error(fleet.source, why, f"robots.{robot.name}.plugins")


def _require_used(source: Path, robot: str, instance: str, text: str, file: Path) -> None:
    """Raise ConfigError unless the fleet file is valid and gives the robot the calibration of the file."""
    manager = EALConfigManager.load(source)
    config = manager.robot(robot)
    problems, _ = EALPluginManager(manager.fleet.plugin_dirs).check(config)
    if problems:
        raise ConfigError(problems)
    wanted = parse_yaml(text, str(file)).root["robots"][robot]["plugins"][instance][KEY]
    settings: Mapping[str, Any] = config.plugins[instance].settings
    if settings[KEY] != wanted:
        message = "is set here and would override the measured calibration: remove it, then try again"
        raise ConfigError([config.plugins[instance].problem((KEY,), message)])
