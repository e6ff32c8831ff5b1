"""`eal init`: prepare a folder for an editor that completes and checks fleets, scenarios, worlds and plugins."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from eal_actors.cli.check import schema_of
from eal_actors.cli.output import print_line, stdout
from eal_actors.kernel.errors import file_error, unwritable_error
from eal_actors.lab.fleet_edits import replace_file

SCHEMAS: Final = Path(".vscode/eal")
"""The folder of the schemas, below the prepared folder."""
_GLOBS: Final = {
    "fleet": ["fleet.yaml", "*.fleet.yaml", "*-fleet.yaml", "fleets/*.yaml"],
    "scenario": ["scenario.yaml", "*.scenario.yaml", "*-scenario.yaml", "scenarios/*.yaml"],
    "world": ["world.yaml", "*.world.yaml", "*-world.yaml", "worlds/*.yaml"],
    "plugin": ["plugin.yaml"],
}
_EXTENSION: Final = "redhat.vscode-yaml"


def init_folder(
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", file_okay=False, help="The folder.")] = Path(),
) -> None:
    """Write `.vscode` with JSON Schemas of fleets, scenarios, worlds and plugins, for Visual Studio Code and others.

    The schema of fleets has the settings of the plugins that are installed here: run the command again after a change
    of them. Settings that the folder has already stay. Files that `eal new` writes there name their schema in a
    header, which every editor with the YAML language server reads.
    """
    schemas = folder / SCHEMAS
    settings, extensions = folder / ".vscode/settings.json", folder / ".vscode/extensions.json"
    kept, wanted = _read(settings, "yaml.schemas", {}), _read(extensions, "recommendations", [])
    try:
        schemas.mkdir(parents=True, exist_ok=True)
        for kind in _GLOBS:
            (schemas / f"{kind}.schema.json").write_text(_as_json(schema_of(kind)), encoding="utf-8")
        ours = {f"./{SCHEMAS.as_posix()}/{kind}.schema.json": globs for kind, globs in _GLOBS.items()}
    except OSError as error:
        raise unwritable_error(error.filename, error) from error
    replace_file(settings, _as_json({**kept, "yaml.schemas": {**kept["yaml.schemas"], **ours}}))
    recommended = list(dict.fromkeys([*wanted["recommendations"], _EXTENSION]))
    replace_file(extensions, _as_json({**wanted, "recommendations": recommended}))
    out = stdout()
    print_line(out, f"{settings}: YAML files of {folder.resolve().name} are completed and checked")
    print_line(out, "next: eal new fleet; eal new scenario", "dim")


def header_for(file: Path, kind: str) -> str:
    """Return the first line of a new file: its schema, if the file's folder or one above was prepared; else nothing."""
    here = file.resolve().parent
    for number, folder in enumerate((here, *here.parents)):
        schema = folder / SCHEMAS / f"{kind}.schema.json"
        if schema.is_file():
            place = "/".join([*[".."] * number, SCHEMAS.as_posix(), schema.name])
            return f"# yaml-language-server: $schema={place}\n"
    return ""


def _read(file: Path, key: str, empty: object) -> dict[str, Any]:
    """Return the settings of a file, in which a key has a value, an empty one without the file.

    Raises ConfigError if it is no JSON, such as with comments, or the value is of another type.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {key: empty}
    except (OSError, ValueError) as error:
        why = f'cannot be extended ({error}): remove its comments, or add "yaml.schemas" by hand'
        raise file_error(file, why) from error
    if not isinstance(content, dict):
        raise file_error(file, "must be a mapping")
    if type(content.setdefault(key, empty)) is not type(empty):
        raise file_error(file, f"'{key}' must be a {'mapping' if isinstance(empty, dict) else 'list'}")
    return content


def _as_json(content: dict[str, Any]) -> str:
    return json.dumps(content, indent=2) + "\n"
