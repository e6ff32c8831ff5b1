"""`eal plugin`: list, create and check plugins."""

from __future__ import annotations

import keyword
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from io import StringIO
from pathlib import Path
from shutil import rmtree
from string import Template
from typing import Annotated, Any, Final

import typer
from rich.text import Text

from eal_actors import plugin as plugin_api
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import EalCommand, EalCommandGroup, GlobalOptions, JsonOption
from eal_actors.cli.output import PAGE_WIDTH, counted, new_table, print_line, stderr, stdout, write_json
from eal_actors.cli.plugin_settings import SettingOption, parse_settings
from eal_actors.kernel.bundled import is_installed, short_path
from eal_actors.kernel.errors import file_error
from eal_actors.kernel.log import configure_logging
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.manifest import discover
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.testing.conformance import Bench, CheckResult, run_checks, settings_of

app = typer.Typer(cls=EalCommandGroup, help="List, create and check plugins.", no_args_is_help=True)

_TEMPLATES: Final = Path(__file__).with_name("plugin_template")
_NAME: Final = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
_STYLES: Final = {"ok": ("ok", "green"), "failed": ("FAILED", "bold red"), "skipped": ("skipped", "dim")}


@app.command("list", cls=EalCommand)
def list_plugins(
    directories: Annotated[list[Path] | None, typer.Option("--dir", help="Search this folder too; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """List the plugins of the given folders, the bundled ones, and those of installed packages. None is imported."""
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
        print_line(stderr(), Text.assemble(("broken: ", "yellow"), str(error)))


def _print_list(found: Sequence[dict[str, Any]]) -> None:
    table = new_table("plugin", "version", "resources", "description")
    for plugin in found:
        about = Text(plugin["description"])
        if not is_installed(Path(plugin["folder"])):  # those of the framework have one long folder in common
            about.append(f"\nin {plugin['folder']}", style="dim")
        if plugin["missing"]:
            about.append(f"\nmissing: {', '.join(plugin['missing'])}", style="yellow")
        table.add_row(Text(plugin["name"], style="cyan"), plugin["version"], "\n".join(plugin["resources"]), about)
        table.add_section()
    stdout(PAGE_WIDTH).print(table)


@app.command("new", cls=EalCommand)
def new_plugin(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Lower-case letters, digits and '_'.")],
    directory: Annotated[Path, typer.Option("--dir", help="Parent of the plugin's folder.")] = Path("plugins"),
) -> None:
    """Write a working plugin with its test, as a start for your own."""
    folder = write_plugin(name, directory)
    console = stdout()
    for file in sorted(folder.iterdir()):
        print_line(console, str(file))
    print_line(console, f"\nNext: eal plugin check {folder}", "dim")


def write_plugin(name: str, directory: Path) -> Path:
    """Write a plugin's folder from the templates, below a parent that is made if it does not exist; return the folder.

    Raises ConfigError if the name cannot be used, or the folder exists or cannot be written.
    """
    resource = "".join(part.capitalize() for part in name.split("_"))
    folder = directory / name
    if not _NAME.fullmatch(name):
        raise file_error(name, "a plugin's name is a lower-case letter, then lower-case letters, digits and single '_'")
    if keyword.iskeyword(name) or keyword.iskeyword(resource) or resource in plugin_api.__all__:
        raise file_error(name, f"its resource would be {resource!r}, a reserved name; choose another")
    try:
        with ExitStack() as undo:
            folder.mkdir(parents=True)
            undo.callback(rmtree, folder, ignore_errors=True)
            for template in sorted(_TEMPLATES.iterdir()):
                file = folder / template.name.removesuffix(".txt").replace("NAME", name)
                text = Template(template.read_text(encoding="utf-8")).substitute(name=name, resource=resource)
                file.write_text(text, encoding="utf-8")
            undo.pop_all()
    except FileExistsError:
        raise file_error(folder, "exists already; nothing was written") from None
    except OSError as error:
        raise file_error(folder, f"cannot be written: {error.strerror}") from error
    return folder


@app.command("check", cls=EalCommand)
def check_plugin(
    context: typer.Context,
    plugin: Annotated[Path, typer.Argument(help="The plugin's folder, or the name of one that is installed.")],
    setting: SettingOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check that a plugin meets the contract of all plugins.

    The check connects a robot with this plugin, and moves its actuators for a moment. The exit code is 1 if a check
    failed. Log lines are shown at the end, because the checks cause most of them, such as by unplugging the device.
    """
    results = []
    known = discover(())[0] if not plugin.exists() else {}
    if known and str(plugin) not in known:
        raise file_error(plugin, f"no such folder, and no plugin of that name{did_you_mean(str(plugin), known)}")
    folder = known[str(plugin)].folder if known else plugin
    bench = Bench(folder, settings_of(parse_settings(setting or [])))
    with _log_at_the_end(GlobalOptions.of(context)):
        for result in run_checks(bench):
            results.append(result)
            if not as_json:
                _print_result(result)
    failed = sum(result.outcome == "failed" for result in results)
    if as_json:
        write_json({"folder": str(folder), "checks": [_check_as_json(result) for result in results]})
    else:
        stderr().print(f"{counted(failed, 'check')} failed" if failed else f"{folder}: conforms")
    if failed:
        raise typer.Exit(ExitCode.FAILED)


@contextmanager
def _log_at_the_end(options: GlobalOptions) -> Iterator[None]:
    """Hold log lines back during a `with` block, and write them to stderr at its end."""
    held = StringIO()
    configure_logging(options.log_format, options.log_level, held)
    try:
        yield
    finally:
        configure_logging(options.log_format, options.log_level)
        sys.stderr.write(held.getvalue())


def _print_result(result: CheckResult) -> None:
    reasons = f"  {'; '.join(result.problems)}" if result.outcome != "failed" and result.problems else ""
    console = stdout()
    print_line(console, Text.assemble(f"{result.check.name:<28}", _STYLES[result.outcome], (reasons, "dim")))
    if result.outcome == "failed":
        for problem in result.problems:
            print_line(console, f"    {problem}")


def _check_as_json(result: CheckResult) -> dict[str, Any]:
    about = {"check": result.check.name, "description": result.check.description}
    return {**about, "outcome": result.outcome, "problems": list(result.problems)}
