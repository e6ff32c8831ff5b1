"""`eal init`: prepare a folder for an editor that completes and checks fleets, scenarios, worlds and plugins."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from eal_actors.cli.check import schema_of
from eal_actors.cli.output import print_line, stdout
from eal_actors.kernel.errors import file_error, unwritable_error

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
    kept, wanted = _read(settings), _read(extensions)
    try:
        schemas.mkdir(parents=True, exist_ok=True)
        for kind in _GLOBS:
            _write(schemas / f"{kind}.schema.json", schema_of(kind))
        ours = {f"./{SCHEMAS.as_posix()}/{kind}.schema.json": globs for kind, globs in _GLOBS.items()}
        _write(settings, {**kept, "yaml.schemas": {**kept.get("yaml.schemas", {}), **ours}})
        recommended = list(dict.fromkeys([*wanted.get("recommendations", []), _EXTENSION]))
        _write(extensions, {**wanted, "recommendations": recommended})
    except OSError as error:
        raise unwritable_error(error.filename, error) from error
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


def _read(file: Path) -> dict[str, Any]:
    """Return the settings of a file, nothing without one; raise ConfigError if it is no JSON, such as with comments."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        why = f'cannot be extended ({error}): remove its comments, or add "yaml.schemas" by hand'
        raise file_error(file, why) from error
    if not isinstance(content, dict):
        raise file_error(file, "must be a mapping")
    return content


def _write(file: Path, content: dict[str, Any]) -> None:
    file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
