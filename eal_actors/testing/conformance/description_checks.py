"""Checks of a plugin's description of itself."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

from eal_actors.device.data import DataType
from eal_actors.device.info import ResourceInfo, ValueInfo
from eal_actors.managers.fleet_model import PluginSettings
from eal_actors.managers.plugins import EALPluginManager, import_plugin
from eal_actors.testing.conformance.bench import ROBOTS, Bench, Findings, settings_of

_MEASURED = (DataType.FLOAT, DataType.DOUBLE)


def starts(bench: Bench, findings: Findings) -> None:
    """Its manifest is valid, fits its folder and twin, `connect` names declared resources, and all resources start."""
    manifest = bench.manifest()
    if contradictions := manifest.contradictions():
        findings.problems += contradictions
        return
    missing = manifest.missing_modules()
    findings.expect(not missing, f"required modules are not installed: {', '.join(missing)}")
    manager = EALPluginManager([bench.folder.resolve().parent])
    if (twin := manifest.file.twin) is not None:
        settings = PluginSettings(twin.plugin, twin.plugin, settings_of(twin.settings))
        wrong, _ = manager.check(replace(bench.config([bench.settings]).robots[ROBOTS[0]], plugins={"twin": settings}))
        findings.problems += [f"twin: {problem}" for problem in wrong]
    found = manager.manifests[manifest.name].folder
    findings.expect(found.resolve() == bench.folder.resolve(), f"the plugin in {found} has the same name and hides it")
    with bench.robot() as robot:
        promised, there = set(manifest.file.resources), set(robot)
        has_settings = hasattr(import_plugin(manifest), "Settings")  # settings may select the resources
        findings.expect(
            promised == there or (has_settings and (there < promised or not promised)),
            f"the manifest declares {', '.join(sorted(promised))}, but it has {', '.join(sorted(there))}",
        )


def describes_itself(bench: Bench, findings: Findings) -> None:
    """Every resource, command, request and configuration key has a description, and measured values have a unit."""
    with bench.robot() as robot:
        for name, handle in robot.items():
            for gap in _gaps(handle.info):
                findings.expect(False, f"{name}: {gap}")
            findings.tried += 1


def _gaps(info: ResourceInfo) -> Iterator[str]:
    if not info.types:
        yield "has no type; set `types`"
    if not info.methods:
        yield "supports no method at all"
    if not info.description:
        yield "has no description; give its class a docstring"
    if info.value is not None:
        yield from _value_gaps("its value", info.value)
    for kind, entries in (("command", info.commands), ("request", info.requests)):
        for entry in entries:
            what = f"{kind} {entry.name!r}"
            if not entry.description:
                yield f"{what} has no description; give its method a docstring"
            for part, value in (("argument", entry.argument), ("answer", entry.returns)):
                if value is not None:
                    yield from _value_gaps(f"the {part} of {what}", value)
    for key in info.configs:
        if not key.description:
            yield f"configuration key {key.name!r} has no description; give its method a docstring"
        yield from _value_gaps(f"configuration key {key.name!r}", key.value)


def _value_gaps(what: str, value: ValueInfo) -> Iterator[str]:
    if value.type in _MEASURED and value.unit is None and not value.description:
        yield f"{what} has no unit; a number without one needs a description in its ValueInfo"
    if value.minimum is not None and value.maximum is not None and value.minimum > value.maximum:
        yield f"{what} has an empty range: {value.minimum:g}..{value.maximum:g}"


def survives_json(bench: Bench, findings: Findings) -> None:
    """A resource's description survives a round trip through JSON."""
    with bench.robot() as robot:
        for name, handle in robot.items():
            info = handle.info
            try:
                again: object = ResourceInfo.from_dict(json.loads(json.dumps(info.to_dict())))
            except (TypeError, ValueError, LookupError) as error:
                again = f"{type(error).__name__}: {error}"
            findings.expect(again == info, f"{name}: {info} became {again}")
