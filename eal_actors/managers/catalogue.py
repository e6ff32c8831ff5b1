"""The JSON Schema of fleet files with the settings of the plugins that are installed, for editors.

The schema of a fleet file alone accepts any settings. With the plugins' models an editor knows, for example, which
models the plugin `sim` has. A level of a fleet file may give a part of the settings, so none of them is required here.
"""

from __future__ import annotations

from typing import Any, Final

from eal_actors.kernel.errors import PluginError
from eal_actors.managers.config import fleet_schema
from eal_actors.managers.manifest import PluginManifest
from eal_actors.managers.plugins import EALPluginManager, import_plugin

_LATER: Final = {"type": "string", "pattern": r"\$\{|\{n\}"}  # a text that becomes another value when the file is read


def catalogue_schema(manager: EALPluginManager) -> dict[str, Any]:
    """Return the schema of fleet files with the settings of each plugin that can be imported here."""
    schema = fleet_schema()
    definitions = schema["$defs"]
    found: dict[str, dict[str, Any]] = {}
    for name, manifest in manager.manifests.items():
        if (settings := _settings_schema(name, manifest)) is None:
            continue
        definitions.update({f"{name}.{key}": value for key, value in settings.pop("$defs", {}).items()})
        definitions[f"settings.{name}"] = settings
        found[name] = {"$ref": f"#/$defs/settings.{name}"}
    section = definitions["PluginSection"]
    section["allOf"] = [
        {"if": {"properties": {"plugin": {"const": name}}, "required": ["plugin"]}, "then": settings}
        for name, settings in found.items()
    ]
    by_name = {
        name: {"if": {"not": {"required": ["plugin"]}}, "then": settings, "else": {"$ref": "#/$defs/PluginSection"}}
        for name, settings in found.items()
    }
    for definition in definitions.values():
        plugins = definition.get("properties", {}).get("plugins", {})
        if "#/$defs/PluginSection" in str(plugins.get("patternProperties")):
            plugins["properties"] = by_name
    return schema


def _relax(schema: object) -> None:
    """Let every level of a schema give a part: nothing is required, so several alternatives may fit."""
    if isinstance(schema, dict):
        if isinstance(schema.get("required"), list):
            del schema["required"]
        if "oneOf" in schema:
            schema["anyOf"] = schema.pop("oneOf")
            schema.pop("discriminator", None)
    for part in schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else ():
        _relax(part)


def _settings_schema(name: str, manifest: PluginManifest) -> dict[str, Any] | None:
    """Return the schema of a plugin's settings; None if it has none, or cannot be imported here."""
    try:
        model = getattr(import_plugin(manifest), "Settings", None)
    except PluginError:
        return None
    if model is None:
        return None
    schema: dict[str, Any] = model.model_json_schema(ref_template=f"#/$defs/{name}.{{model}}")
    _relax(schema)
    properties = {key: {"anyOf": [value, _LATER]} for key, value in schema.get("properties", {}).items()}
    schema["properties"] = {"plugin": {"const": name}, **properties}
    return schema
