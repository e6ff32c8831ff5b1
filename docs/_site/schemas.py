"""The directive `eal-schema`: a file format, told from the JSON Schema that `eal schema` prints."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from eal_actors.managers.config import fleet_schema, manifest_schema, world_schema
from eal_actors.scenario import scenario_schema

SCHEMAS = {"fleet": fleet_schema, "scenario": scenario_schema, "world": world_schema, "plugin": manifest_schema}


def schema_markdown(kind: str) -> str:
    """Return a page of Markdown: a table of keys for the file itself and for each section of it."""
    schema = SCHEMAS[kind]()
    lines = [f"## The file\n\n{_keys(kind, schema, schema)}"]
    for name, section in sorted(schema.get("$defs", {}).items()):
        if "properties" in section:
            lines.append(f"({_anchor(kind, name)})=\n## {name}\n\n{_text(section)}\n\n{_keys(kind, section, schema)}")
        elif "enum" in section:
            lines.append(f"({_anchor(kind, name)})=\n## {name}\n\n{_text(section)}\n\nOne of {_values(section)}.")
    return "\n\n".join(lines)


def _anchor(kind: str, name: str) -> str:
    return f"schema-{kind}-{name}".lower().replace("_", "-")


def _keys(kind: str, section: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    needed = section.get("required", ())
    rows = [
        f"| `{key}`{star} | {_type(kind, value, schema)} | {_default(value)} | {_text(value)} |"
        for key, value in section["properties"].items()
        for star in (" \\*" if key in needed else "",)
    ]
    return "\n".join(["| key | type | if left out | meaning |", "|---|---|---|---|", *rows])


def _type(kind: str, value: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    return "; ".join(dict.fromkeys(_types(kind, value, schema))) or "anything"


def _types(kind: str, value: Mapping[str, Any], schema: Mapping[str, Any]) -> Iterator[str]:
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        section = schema["$defs"][name]
        if "properties" in section or "enum" in section:
            yield f"[{name}](#{_anchor(kind, name)})"
        else:
            yield from _types(kind, section, schema)
    for part in (*value.get("anyOf", ()), *value.get("oneOf", ()), *value.get("allOf", ())):
        yield from _types(kind, part, schema)
    if "const" in value:
        yield f"`{json.dumps(value['const'])}`"
    elif "enum" in value:
        yield _values(value)
    elif isinstance(value.get("type"), str):
        yield _plain(kind, value, schema)


def _plain(kind: str, value: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    name = {"null": "nothing", "string": "text", "integer": "whole number", "boolean": "true or false"}.get(
        value["type"], value["type"]
    )
    if value["type"] == "array":
        items = value.get("items")
        return f"list of {_type(kind, items, schema)}" if isinstance(items, Mapping) else "list"
    if value["type"] == "object":
        items = value.get("additionalProperties") or next(iter(value.get("patternProperties", {}).values()), None)
        return f"mapping to {_type(kind, items, schema)}" if isinstance(items, Mapping) else "mapping"
    return f"{name}{_range(value)}"


def _range(value: Mapping[str, Any]) -> str:
    words = (("minimum", "from"), ("exclusiveMinimum", "over"), ("maximum", "to"), ("exclusiveMaximum", "under"))
    said = [f"{word} {value[key]:g}" for key, word in words if key in value]
    return f" {' '.join(said)}" if said else ""


def _values(value: Mapping[str, Any]) -> str:
    return ", ".join(f"`{json.dumps(item)}`" for item in value["enum"])


def _default(value: Mapping[str, Any]) -> str:
    if not isinstance(value.get("default"), bool | int | float | str) or value["default"] == "":
        return ""
    return f"`{json.dumps(value['default'])}`"


def _text(value: Mapping[str, Any]) -> str:
    return " ".join(value.get("description", "").replace("|", "\\|").split())


class SchemaDirective(SphinxDirective):
    """`{eal-schema} fleet`."""

    required_arguments = 1
    has_content: ClassVar[bool] = False

    def run(self) -> list[nodes.Node]:
        """Return the page."""
        return self.parse_text_to_nodes(schema_markdown(self.arguments[0]), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("eal-schema", SchemaDirective)
    return {"parallel_read_safe": True}
