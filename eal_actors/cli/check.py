"""`eal check`: what is wrong with fleet, scenario and world files, without touching a robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.opening import check_plugins
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import counted, stderr, stdout, write_json
from eal_actors.cli.world import contents
from eal_actors.device.world import load_world
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import load_scenario


@dataclass(frozen=True, slots=True)
class Checked:
    """What came of a file.

    Attributes:
        file: the file, as it was named.
        kind: `fleet`, `scenario`, `world` or `plugin`; `unknown` where the content does not tell.
        summary: what a good file holds, in few words.
        problems: what is wrong.
        warnings: what may be wrong only on this machine, such as a module that a plugin needs.
    """

    file: str
    kind: str
    summary: str = ""
    problems: tuple[Problem, ...] = ()
    warnings: tuple[str, ...] = ()


def check_files(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE", help="Fleet, scenario and world files.", show_default=False)
    ],
    as_json: JsonOption = False,
) -> None:
    """Check files, and print each problem as `file:line:column: path: message`.

    Their content tells what they are. Of a fleet the plugins' settings are checked too, for which the plugins are
    imported, but nothing is connected. Ends with 2 if there are problems.
    """
    results = [check_file(file) for file in files]
    problems = sorted({problem for result in results for problem in result.problems})
    if as_json:
        write_json({"files": [asdict(result) for result in results]})
    else:
        _print(results, problems)
    if problems:
        raise typer.Exit(ExitCode.BAD_INPUT)


def _print(results: list[Checked], problems: list[Problem]) -> None:
    out, err = stdout(), stderr()
    for warning in dict.fromkeys(warning for result in results for warning in result.warnings):
        err.print(Text.assemble(("warning: ", "yellow"), warning), soft_wrap=True)
    for result in results:
        if not result.problems:
            out.print(Text.assemble(f"{result.file}: ", ("ok", "green"), f" ({result.summary})"), soft_wrap=True)
    for problem in problems:
        out.print(Text(str(problem)), soft_wrap=True)
    if problems:
        files = {problem.file for problem in problems}
        err.print(f"{counted(len(problems), 'problem')} in {counted(len(files), 'file')}", style="bold red")


def check_file(file: Path) -> Checked:
    """Check one file, of whatever kind it is."""
    name = str(file)
    try:
        keys = set(load_yaml(file).root)
    except ConfigError as error:
        return Checked(name, "unknown", problems=error.problems)
    for kind, tell_tale, check in _KINDS:
        if keys & tell_tale:
            try:
                return check(name)
            except ConfigError as error:
                return Checked(name, kind, problems=error.problems)
    hint = "a fleet has robots, a scenario has steps, a world has size_m"
    return Checked(name, "unknown", problems=(Problem(name, 0, 0, "", f"cannot tell what it is: {hint}"),))


def _check_fleet(name: str) -> Checked:
    config = EALConfigManager.load(name).fleet
    problems, warnings = check_plugins(config)
    summary = f"fleet, {counted(len(config.robots), 'robot')}"
    return Checked(name, "fleet", summary, tuple(sorted(problems)), tuple(warnings))


def _check_scenario(name: str) -> Checked:
    file = load_scenario(name).file
    return Checked(
        name, "scenario", f"scenario, {counted(len(file.roles), 'role')}, {counted(len(file.steps), 'step')}"
    )


def _check_world(name: str) -> Checked:
    return Checked(name, "world", f"world, {contents(load_world(name))}")


def _refuse_plugin(name: str) -> Checked:
    advice = f"a plugin: use `eal plugin check {Path(name).parent}`"
    return Checked(name, "plugin", problems=(Problem(name, 0, 0, "", advice),))


# Kind, the keys that only files of that kind have, and the check.
_KINDS: Final[tuple[tuple[str, frozenset[str], Callable[[str], Checked]], ...]] = (
    ("scenario", frozenset({"steps", "roles"}), _check_scenario),
    ("world", frozenset({"size_m"}), _check_world),
    ("plugin", frozenset({"plugin_version", "resources"}), _refuse_plugin),
    ("fleet", frozenset({"robots", "types", "defaults", "plugin_dirs", "include"}), _check_fleet),
)
