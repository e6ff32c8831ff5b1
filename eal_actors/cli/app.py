"""The program `eal`: its commands, global options, error handling and signal handling."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Annotated, Any, Final

import typer
from typer.main import get_group

from eal_actors import __version__
from eal_actors.cli.exit_codes import EPILOG, ExitCode, report_error, write_error
from eal_actors.cli.interrupts import handle_signals, was_interrupted
from eal_actors.cli.options import EalCommand, EalCommandGroup, GlobalOptions, LogLevel
from eal_actors.cli.streams import failsafe_output
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import LogFormat, configure_logging
from eal_actors.kernel.printable import printable

_COMMANDS: Final = {
    "run": "run:run_scenario",
    "rehearse": "rehearse:rehearse_scenario",
    "prove": "prove:prove_scenario",
    "sweep": "sweep:sweep_scenario",
    "calibrate": "calibrate_camera:app",
    "report": "records:report_run",
    "diff": "records:diff_runs",
    "branch": "branch:branch_run",
    "bisect": "branch:bisect_run",
    "replay": "records:replay_run",
    "record": "record:record_fleet",
    "records": "records_repair:app",
    "check": "check:check_files",
    "show": "show:show_scenario",
    "schema": "check:print_schema",
    "world": "world:show_world",
    "map": "maps:show_map",
    "resources": "resources:list_resources",
    "call": "call:call_method",
    "stitch": "stitch:stitch_frames",
    "serve": "serve:serve_robot",
    "bridge": "bridge:bridge_fleet",
    "dashboard": "dashboard:show_dashboard",
    "drive": "drive:drive_robots",
    "mcp": "mcp:serve_agents",
    "approve": "mcp:approve_plan",
    "audit": "audit:show_audit",
    "top": "top:show_top",
    "ping": "ping:ping_robots",
    "stop": "stop:stop_robots",
    "resume": "stop:resume_robots",
    "discover": "discover:discover_robots",
    "doctor": "doctor:examine",
    "ports": "ports:show_ports",
    "router": "router:run_router",
    "keys": "dashboard_keys:app",
    "plugin": "plugin:app",
    "init": "init:init_folder",
    "new": "new:app",
    "tracker": "tracker:app",
    "demo-network": "demo_network:demo_network",
    "lab": "lab:run_lab",
}
"""The module of each command in this package, and its function or group."""

_SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "call": {"context_settings": {"ignore_unknown_options": True}},  # -5 is a number
    "demo-network": {"hidden": True},  # for `make demo-network`
    "lab": {"hidden": True},  # for `make lab`
}


_UsageError: Final[Any] = typer.BadParameter.__mro__[1]  # of the click that typer uses, which newer versions contain


class _Commands(Mapping[str, Any]):
    """The commands by name, each loaded when it is used: together they load for a second, longer on a small board."""

    def __init__(self) -> None:
        self._loaded: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        if name not in self._loaded:
            module, attribute = _COMMANDS[name].split(":")
            part = getattr(import_module(f"eal_actors.cli.{module}"), attribute)
            parent = typer.Typer(callback=lambda: None, add_completion=False, **_LOOK)
            if isinstance(part, typer.Typer):
                parent.add_typer(part, name=name)
            else:
                parent.command(name, cls=EalCommand, **_SETTINGS.get(name, {}))(part)
            self._loaded[name] = get_group(parent).commands[name]
        return self._loaded[name]

    def __iter__(self) -> Iterator[str]:
        return iter(_COMMANDS)

    def __len__(self) -> int:
        return len(_COMMANDS)


class _EalProgram(EalCommandGroup):
    """The only place that turns an error into a message and an exit code."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = _Commands()  # type: ignore[assignment]  # nothing is added

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Load the command. From here on garbage is collected and signals raise: `eal_actors.__main__` ended both."""
        try:
            return super().resolve_command(ctx, args)
        finally:
            if not gc.isenabled():
                gc.enable()
                handle_signals()

    def invoke(self, ctx: Any) -> Any:
        words = [*getattr(ctx, "_protected_args", ()), *ctx.args]
        as_json = "--json" in (words[: words.index("--")] if "--" in words else words)
        try:
            return super().invoke(ctx)
        except EALError as error:
            raise typer.Exit(report_error(error, GlobalOptions.of(ctx), as_json=as_json)) from error
        except _UsageError as error:
            if not as_json:
                error.message = printable(error.message)  # typer has a console of its own
                raise
            write_error("usage", error.format_message(), ExitCode.BAD_INPUT)
            raise typer.Exit(ExitCode.BAD_INPUT) from error
        except KeyboardInterrupt:
            raise typer.Exit(ExitCode.INTERRUPTED) from None
        except (typer.Exit, typer.Abort):
            raise
        except Exception:
            if not was_interrupted():  # else pydantic, or an import, has made another error of it
                raise
            raise typer.Exit(ExitCode.INTERRUPTED) from None


_LOOK: Final[dict[str, Any]] = {
    "rich_markup_mode": "markdown",  # joins the lines of a paragraph
    "pretty_exceptions_enable": False,
}

app = typer.Typer(
    name="eal",
    cls=_EalProgram,
    help="Run one scenario across a fleet of different robots.\n\n"
    "Put --log-format and --log-level before the command: `eal --log-level debug run ...`",
    epilog=EPILOG,
    no_args_is_help=True,
    **_LOOK,
)


def _show_version(value: bool) -> None:
    if value:
        sys.stdout.write(f"eal {__version__}\n")
        raise typer.Exit


@app.callback()
def _global_options(
    context: typer.Context,
    log_format: Annotated[LogFormat, typer.Option(help="Format of log lines on stderr.")] = "human",
    log_level: Annotated[LogLevel, typer.Option(help="Lowest log level shown; debug adds tracebacks.")] = "warning",
    version: Annotated[  # noqa: ARG001  # its callback does the work
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    context.obj = GlobalOptions(log_format, log_level)
    configure_logging(log_format, log_level)


def main() -> None:
    """Run the program and exit."""
    with failsafe_output():
        app(prog_name="eal")
