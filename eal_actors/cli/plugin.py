"""`eal plugin`: list, begin and check plugins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.help import Command, Group
from eal_actors.cli.new_plugin import write_plugin
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import counted, new_table, short_path, stderr, stdout, write_json
from eal_actors.kernel.errors import ConfigError
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.testing.conformance import Bench, CheckResult, run_checks, settings_of

app = typer.Typer(cls=Group, help="List, begin and check plugins.", no_args_is_help=True)

_STYLES: Final = {"ok": ("ok", "green"), "failed": ("FAILED", "bold red"), "skipped": ("skipped", "dim")}


@app.command("list", cls=Command)
def list_plugins(
    directories: Annotated[
        list[Path] | None, typer.Option("--dir", show_default=False, help="Search this folder too; may be repeated.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the plugins that are found: in the given folders, bundled, and of installed packages. None is imported."""
    manager = EALPluginManager(directories or ())
    found = [
        {
            "name": manifest.name,
            "version": manifest.file.plugin_version,
            "resources": list(manifest.file.resources),
            "description": manifest.file.description,
            "folder": str(short_path(manifest.folder)),
            "missing": list(manifest.missing_modules()),
        }
        for manifest in manager.manifests.values()
    ]
    if as_json:
        write_json({"plugins": found, "broken": [str(error) for error in manager.errors]})
        return
    _print_list(found)
    for error in manager.errors:
        stderr().print(Text.assemble(("broken: ", "yellow"), str(error)), soft_wrap=True)


def _print_list(found: Sequence[dict[str, Any]]) -> None:
    table = new_table("plugin", "version", "resources", "description")
    for plugin in found:
        about = Text.assemble(plugin["description"], (f"\nin {plugin['folder']}", "dim"))
        if plugin["missing"]:
            about.append(f"\nmissing: {', '.join(plugin['missing'])}", style="yellow")
        table.add_row(Text(plugin["name"], style="cyan"), plugin["version"], "\n".join(plugin["resources"]), about)
        table.add_section()
    stdout().print(table)


@app.command("new", cls=Command)
def new_plugin(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="Lower-case letters, digits and '_'.", show_default=False)
    ],
    directory: Annotated[Path, typer.Option("--dir", help="Where the plugin's folder is made.")] = Path("plugins"),
) -> None:
    """Write a plugin that works, with its test, to begin from."""
    folder = write_plugin(name, directory)
    console = stdout()
    for file in sorted(folder.iterdir()):
        console.print(Text(str(file)), soft_wrap=True)
    console.print(Text(f"\nNext: eal plugin check {folder}", style="dim"), soft_wrap=True)


@app.command("check", cls=Command)
def check_plugin(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The plugin's folder.", show_default=False)],
    setting: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY=VALUE", show_default=False, help="A setting, as YAML; may be repeated."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check that a plugin does what every plugin must do.

    Its robot is connected for it, and what can move will move for a moment. Ends with 1 if a check failed.
    """
    results = []
    for result in run_checks(Bench(folder, settings_of(_settings(setting or [])))):
        results.append(result)
        if not as_json:
            _print_result(result)
    failed = sum(result.outcome == "failed" for result in results)
    if as_json:
        write_json({"folder": str(folder), "checks": [_described(result) for result in results]})
    else:
        stderr().print(f"{counted(failed, 'check')} failed" if failed else f"{folder}: conforms")
    if failed:
        raise typer.Exit(ExitCode.FAILED)


def _settings(texts: Sequence[str]) -> dict[str, Any]:
    settings: dict[str, Any] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or not key:
            raise typer.BadParameter(f"a setting is KEY=VALUE, not {text!r}", param_hint="--setting")
        try:
            settings[key] = parse_yaml(f"value: {value}", f"--setting {key}").root["value"]
        except ConfigError as error:
            why = "; ".join(problem.message for problem in error.problems)
            raise typer.BadParameter(f"{text!r}: {why}", param_hint="--setting") from None
    return settings


def _print_result(result: CheckResult) -> None:
    why = f"  {'; '.join(result.problems)}" if result.outcome != "failed" and result.problems else ""
    console = stdout()
    console.print(Text.assemble(f"{result.check.name:<24}", _STYLES[result.outcome], (why, "dim")), soft_wrap=True)
    if result.outcome == "failed":
        for problem in result.problems:
            console.print(Text(f"    {problem}"), soft_wrap=True)


def _described(result: CheckResult) -> dict[str, Any]:
    return {
        "check": result.check.name,
        "description": result.check.description,
        "outcome": result.outcome,
        "problems": list(result.problems),
    }
