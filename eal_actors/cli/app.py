"""The program `eal`: its global options, its commands, and what it does about errors and signals."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from eal_actors import __version__
from eal_actors.cli import (
    calibrate,
    call,
    check,
    dashboard,
    demo_network,
    discover,
    doctor,
    keys,
    lab,
    ping,
    plugin,
    records,
    rehearse,
    resources,
    router,
    run,
    schema,
    serve,
    stitch,
    stop,
    sweep,
    top,
    world,
)
from eal_actors.cli.exit_codes import EPILOG, ExitCode, report
from eal_actors.cli.help import Command, Group
from eal_actors.cli.interrupts import heed_signals
from eal_actors.cli.lasting import lasting_output
from eal_actors.cli.options import GlobalOptions, LogLevel
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import LogFormat, configure_logging


class _Program(Group):
    """The one place where an error becomes a message and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except EALError as error:
            options = ctx.find_object(GlobalOptions) or GlobalOptions()
            raise typer.Exit(report(error, options)) from error
        except KeyboardInterrupt:
            raise typer.Exit(ExitCode.INTERRUPTED) from None


app = typer.Typer(
    name="eal",
    cls=_Program,
    help="Run one scenario across a fleet of different robots.\n\n"
    "--log-format and --log-level go before the command: `eal --log-level debug run ...`",
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode="markdown",  # which joins the lines of a paragraph
    pretty_exceptions_enable=False,
    add_completion=False,
)


def _show_version(value: bool) -> None:
    if value:
        sys.stdout.write(f"eal {__version__}\n")
        raise typer.Exit


@app.callback()
def _global_options(
    context: typer.Context,
    log_format: Annotated[LogFormat, typer.Option(help="How log lines on stderr look.")] = "human",
    log_level: Annotated[LogLevel, typer.Option(help="The least level shown; debug shows tracebacks.")] = "warning",
    version: Annotated[  # noqa: ARG001  # its callback does the work
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    context.obj = GlobalOptions(log_format, log_level)
    configure_logging(log_format, log_level)


app.command("run", cls=Command)(run.run_scenario)
app.command("rehearse", cls=Command)(rehearse.rehearse_scenario)
app.command("sweep", cls=Command)(sweep.sweep_scenario)
app.command("calibrate", cls=Command)(calibrate.calibrate_robots)
app.command("report", cls=Command)(records.report_run)
app.command("diff", cls=Command)(records.diff_runs)
app.command("replay", cls=Command)(records.replay_run)
app.command("check", cls=Command)(check.check_files)
app.command("schema", cls=Command)(schema.print_schema)
app.command("world", cls=Command)(world.show_world)
app.command("resources", cls=Command)(resources.list_resources)
app.command("call", cls=Command, context_settings={"ignore_unknown_options": True})(call.call_method)  # -5 is a number
app.command("stitch", cls=Command)(stitch.stitch_frames)
app.command("serve", cls=Command)(serve.serve_robot)
app.command("dashboard", cls=Command)(dashboard.show_dashboard)
app.command("top", cls=Command)(top.show_top)
app.command("ping", cls=Command)(ping.ping_robots)
app.command("stop", cls=Command)(stop.stop_robots)
app.command("resume", cls=Command)(stop.resume_robots)
app.command("discover", cls=Command)(discover.discover_robots)
app.command("doctor", cls=Command)(doctor.examine)
app.command("router", cls=Command)(router.run_router)
app.add_typer(keys.app, name="keys")
app.add_typer(plugin.app, name="plugin")
app.command("demo-network", cls=Command, hidden=True)(demo_network.demo_network)  # for `make demo-network`
app.command("lab", cls=Command, hidden=True)(lab.run_lab)  # for `make lab`


def main() -> None:
    """Run the program and exit."""
    heed_signals()
    with lasting_output():
        app(prog_name="eal")
