"""Lenses in a fleet file: the setting `lens` of a camera above the floor.

A lens that the fleet file has is replaced value by value, so that comments and the layout stay. Otherwise it is written
into a file of its own beside the fleet file, which includes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import indent
from typing import Any, Final

import yaml

from eal_actors.kernel.errors import ConfigError, Problem, file_error
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.kernel.yaml_tree import Mark, MarkedDict, YamlTree
from eal_actors.lab.fleet_edits import changed_files, read_text, require_own, with_include
from eal_actors.lab.markers.lens_fit import LensFit
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig

_CAMERAS: Final = "cameras"
_LENS: Final = "lens"


@dataclass(frozen=True, slots=True)
class FleetCamera:
    """A camera above the floor in a fleet file."""

    robot: str
    instance: str
    name: str
    tree: YamlTree

    @property
    def path(self) -> tuple[str, str, str]:
        """Path of the lens in the settings."""
        return (_CAMERAS, self.name, _LENS)


def find_camera(fleet: FleetConfig, wanted: str | None) -> FleetCamera:
    """Return the camera of a name, `CAMERA` or `ROBOT.CAMERA`, or the only one.

    Raises ConfigError if the fleet has no such camera or several, or its file is bundled with the framework.
    """
    require_own(fleet, "calibrate with that")
    found = {f"{camera.robot}.{camera.name}": camera for camera in _cameras(fleet)}
    chosen = [one for full, one in found.items() if wanted in (None, full, one.name)]
    if len(chosen) == 1:
        return chosen[0]
    if not found:
        message = f"has no camera with a {_LENS}: a tracker has its cameras under '{_CAMERAS}'"
    elif chosen:
        message = f"has several cameras: choose one with --camera: {', '.join(found)}"
    else:
        hint = did_you_mean(str(wanted), [*found, *(one.name for one in found.values())])
        message = f"has no camera '{wanted}'{hint or '; it has: ' + ', '.join(found)}"
    raise file_error(fleet.source, message)


def _cameras(fleet: FleetConfig) -> Iterator[FleetCamera]:
    for robot in fleet.robots.values():
        for instance, plugin in robot.plugins.items():
            cameras = plugin.tree.root.get(_CAMERAS)
            for name, settings in cameras.items() if isinstance(cameras, MarkedDict) else ():
                if isinstance(settings, MarkedDict):
                    yield FleetCamera(robot.name, instance, name, plugin.tree)


def write_lens(fleet: FleetConfig, camera: FleetCamera, fit: LensFit, comment: str) -> Path:
    """Write a lens into the fleet file, or into a file beside it which it includes; return the file.

    Raises ConfigError if a file cannot be written, or the changed fleet would be invalid or would not use the lens; all
    files are unchanged then.
    """
    source = fleet.source
    before = read_text(source) or ""
    text = fit.as_yaml()
    lens = parse_yaml(text, _LENS).root[_LENS]
    settings = camera.tree.root[_CAMERAS][camera.name]
    mark = camera.tree.mark_at(camera.path)
    if _LENS in settings and Path(mark.file).resolve() == source.resolve():
        file, texts = source, {source: with_values(before, mark, lens)}
    else:
        file = source.with_name(f"{source.stem}-{camera.robot}-{camera.name}.lens.yaml")
        lines = [f"# {comment}", "version: 1"]
        for depth, key in enumerate(("robots", camera.robot, "plugins", camera.instance, _CAMERAS, camera.name)):
            lines.append(f"{'  ' * depth}{key}:")
        texts = {file: "\n".join(lines) + "\n" + indent(text, "  " * 6)}
        texts[source] = with_include(before, str(source), file.name)
    with changed_files(texts):
        plugin = EALConfigManager.load(source).robot(camera.robot).plugins[camera.instance]
        if plugin.tree.root[_CAMERAS][camera.name].get(_LENS) != lens:
            raise ConfigError([plugin.tree.problem(camera.path, "cannot be changed automatically: replace it by hand")])
    return file


def with_values(text: str, mark: Mark, values: Mapping[str, Any]) -> str:
    """Return a YAML text in which the mapping at a place has other values; comments and other keys stay.

    Raises ConfigError if there is no mapping at that place.
    """
    node = _node_at(yaml.compose(text, Loader=yaml.BaseLoader), mark)
    if not isinstance(node, yaml.MappingNode):
        raise ConfigError([Problem(mark.file, mark.line, mark.column, "", "must be a mapping")])
    for start, end, new in sorted(_edits(node, values), reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _node_at(node: yaml.Node | None, mark: Mark) -> yaml.Node | None:
    waiting = [node]
    while waiting:
        one = waiting.pop()
        if isinstance(one, yaml.MappingNode):
            for _, value in one.value:
                if (value.start_mark.line + 1, value.start_mark.column + 1) == (mark.line, mark.column):
                    return value  # type: ignore[no-any-return]
                waiting.append(value)
        elif isinstance(one, yaml.SequenceNode):
            waiting += one.value
    return None


def _edits(node: yaml.Node, value: Any) -> Iterator[tuple[int, int, str]]:
    """Yield what to replace: the first character, the one after the last, and the new text."""
    if isinstance(node, yaml.MappingNode) and isinstance(value, Mapping) and node.value:
        known = {key.value: child for key, child in node.value}
        for key in known.keys() & value.keys():
            yield from _edits(known[key], value[key])
        first = node.value[0][0].start_mark
        between = ", " if node.flow_style else "\n" + " " * first.column
        missing = [f"{key}: {_flow(value[key])}{between}" for key in value if key not in known]
        yield first.index, first.index, "".join(missing)
    elif isinstance(node, yaml.SequenceNode) and isinstance(value, Sequence) and len(node.value) == len(value):
        for child, item in zip(node.value, value, strict=True):
            yield from _edits(child, item)
    else:
        yield node.start_mark.index, node.end_mark.index, _flow(value)


def _flow(value: Any) -> str:
    return f"[{', '.join(map(str, value))}]" if isinstance(value, list) else str(value)
