"""`eal check`: check fleet, scenario and world files without a robot. `eal schema`: print their JSON Schemas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer
from rich.text import Text

from eal_actors.cli.check_together import TogetherCheck, check_together
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import check_plugins
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import counted, print_line, stderr, stdout, write_json
from eal_actors.cli.problems import print_problems
from eal_actors.cli.world import summarize_world
from eal_actors.device.world import load_world
from eal_actors.kernel.bundled import find_files
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.catalogue import catalogue_schema
from eal_actors.managers.config import EALConfigManager, manifest_schema, world_schema
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.scenario import load_scenario, scenario_schema

_SCHEMAS: Final = "https://github.com/eal-actors/eal-actors/schemas"
"""The beginning of the schemas' identifiers, which are names: nothing is served there."""


@dataclass(frozen=True, slots=True)
class FileCheck:
    """The result of checking a file.

    Attributes:
        kind: `fleet`, `scenario`, `world` or `plugin`; `unknown` if its content matches none of them.
        warnings: problems that depend on this machine, such as a missing module of a plugin.
    """

    file: str
    kind: str
    summary: str = ""
    problems: tuple[Problem, ...] = ()
    warnings: tuple[str, ...] = ()


def print_schema(
    kind: Annotated[Literal["fleet", "scenario", "world", "plugin"], typer.Argument(help="Kind of file.")],
) -> None:
    """Print the JSON Schema of a kind of file, for editors that complete and check it."""
    write_json(schema_of(kind))


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file; that of fleets has the settings of the plugins that are installed."""
    makers: dict[str, Callable[[], dict[str, Any]]] = {
        "fleet": lambda: catalogue_schema(EALPluginManager()),
        "scenario": scenario_schema,
        "world": world_schema,
        "plugin": manifest_schema,
    }
    return {"$id": f"{_SCHEMAS}/{kind}/1.json", **makers[kind]()}


def check_files(
    files: Annotated[list[Path], typer.Argument(metavar="FILE", help="Files, or names of bundled ones.")],
    as_json: JsonOption = False,
) -> None:
    """Check fleet, scenario and world files, and print each problem as `file:line:column: path: message`.

    The content of a file determines its kind. The plugins of a fleet are imported to check their settings, but no
    device is connected. With one fleet, each scenario is also checked against it: its roles, resources, commands and
    values, on simulated robots. The exit code is 2 if there are problems.
    """
    results = _check_against_fleet([result for file in files for result in _check_named(file)])
    problems = sorted({problem for result in results for problem in result.problems})
    if as_json:
        write_json({"files": [asdict(result) for result in results]})
    else:
        _print_results(results, problems)
    if problems:
        raise typer.Exit(ExitCode.BAD_INPUT)


def _check_against_fleet(results: list[FileCheck]) -> list[FileCheck]:
    """Check the scenarios against the fleet, if exactly one is given, as far as both can be read."""
    fleets = {result.file for result in results if result.kind == "fleet"}
    if len(fleets) != 1:
        return results
    (fleet,) = fleets
    checked = []
    for result in results:
        try:
            found = check_together(result.file, fleet) if result.kind == "scenario" else TogetherCheck()
        except ConfigError:  # of the fleet file, which was reported
            found = TogetherCheck()
        summary = ", ".join(filter(None, (result.summary, found.summary)))
        problems, warnings = (*result.problems, *found.problems), (*result.warnings, *found.warnings)
        checked.append(replace(result, summary=summary, problems=problems, warnings=warnings))
    return checked


def _print_results(results: list[FileCheck], problems: list[Problem]) -> None:
    out, err = stdout(), stderr()
    warnings = dict.fromkeys(warning for result in results for warning in result.warnings)
    for warning in warnings:
        if any(warning != longer and warning in longer for longer in warnings):
            continue  # the longer one says it too
        print_line(err, Text.assemble(("warning: ", "yellow"), warning))
    for result in results:
        if not result.problems:
            print_line(out, Text.assemble(f"{result.file}: ", ("ok", "green"), f" ({result.summary})"))
    print_problems(out, problems)
    if problems:
        files = {problem.file for problem in problems}
        err.print(f"{counted(len(problems), 'problem')} in {counted(len(files), 'file')}", style="bold red")


def _check_named(name: Path) -> list[FileCheck]:
    """Check the file of a path, or all files of a name."""
    try:
        return [check_file(file) for file in find_files(name)]
    except ConfigError as error:
        return [FileCheck(str(name), "unknown", problems=error.problems)]


def check_file(file: Path) -> FileCheck:
    """Check one file of any kind."""
    name = str(file)
    try:
        keys = set(load_yaml(file).root)
    except ConfigError as error:
        return FileCheck(name, "unknown", problems=error.problems)
    for kind, own_keys, check in _KINDS:
        if keys & own_keys:
            try:
                return check(name)
            except ConfigError as error:
                return FileCheck(name, kind, problems=error.problems)
    hint = "a fleet has robots, a scenario has steps, a world has size_m"
    return FileCheck(name, "unknown", problems=(Problem(name, 0, 0, "", f"unknown kind of file: {hint}"),))


def _check_fleet(name: str) -> FileCheck:
    try:
        config = EALConfigManager.load(name).fleet
    except ConfigError as error:
        valid = EALConfigManager.load_valid_part(name)
        found = check_plugins(valid)[0] if valid is not None else set()
        return FileCheck(name, "fleet", problems=(*error.problems, *sorted(found)))
    problems, warnings = check_plugins(config)
    summary = f"fleet, {counted(len(config.robots), 'robot')}"
    return FileCheck(name, "fleet", summary, tuple(sorted(problems)), tuple(warnings))


def _check_scenario(name: str) -> FileCheck:
    file = load_scenario(name).file
    summary = f"scenario, {counted(len(file.roles), 'role')}, {counted(len(file.steps), 'step')}"
    return FileCheck(name, "scenario", summary)


def _check_world(name: str) -> FileCheck:
    return FileCheck(name, "world", f"world, {summarize_world(load_world(name))}")


def _refuse_plugin(name: str) -> FileCheck:
    advice = f"a plugin: use `eal plugin check {Path(name).parent}`"
    return FileCheck(name, "plugin", problems=(Problem(name, 0, 0, "", advice),))


# Kind, the keys that only files of that kind have, and the check.
_KINDS: Final[tuple[tuple[str, frozenset[str], Callable[[str], FileCheck]], ...]] = (
    ("scenario", frozenset({"steps", "roles"}), _check_scenario),
    ("world", frozenset({"size_m"}), _check_world),
    ("plugin", frozenset({"plugin_version", "resources"}), _refuse_plugin),
    ("fleet", frozenset({"robots", "types", "defaults", "plugin_dirs", "include"}), _check_fleet),
)
