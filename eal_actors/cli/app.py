"""The program `eal`: its commands, global options, error handling and signal handling."""

from __future__ import annotations

import sys
from typing import Annotated, Any

import typer

from eal_actors import __version__
from eal_actors.cli import (
    audit,
    calibrate,
    calibrate_camera,
    call,
    check,
    dashboard,
    dashboard_keys,
    demo_network,
    discover,
    doctor,
    keys_lifetime,
    lab,
    maps,
    ping,
    plugin,
    ports,
    records,
    rehearse,
    resources,
    router,
    run,
    serve,
    stitch,
    stop,
    sweep,
    top,
    tracker,
    world,
)
from eal_actors.cli.exit_codes import EPILOG, ExitCode, report_error
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import EalCommand, EalCommandGroup, GlobalOptions, LogLevel
from eal_actors.cli.streams import failsafe_output
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.log import LogFormat, configure_logging


class _EalProgram(EalCommandGroup):
    """The only place that turns an error into a message and an exit code."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except EALError as error:
            options = ctx.find_object(GlobalOptions) or GlobalOptions()
            raise typer.Exit(report_error(error, options)) from error
        except KeyboardInterrupt:
            raise typer.Exit(ExitCode.INTERRUPTED) from None


app = typer.Typer(
    name="eal",
    cls=_EalProgram,
    help="Run one scenario across a fleet of different robots.\n\n"
    "Put --log-format and --log-level before the command: `eal --log-level debug run ...`",
    epilog=EPILOG,
    no_args_is_help=True,
    rich_markup_mode="markdown",  # joins the lines of a paragraph
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
    log_format: Annotated[LogFormat, typer.Option(help="Format of log lines on stderr.")] = "human",
    log_level: Annotated[LogLevel, typer.Option(help="Lowest log level shown; debug adds tracebacks.")] = "warning",
    version: Annotated[  # noqa: ARG001  # its callback does the work
        bool, typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    context.obj = GlobalOptions(log_format, log_level)
    configure_logging(log_format, log_level)


app.command("run", cls=EalCommand)(run.run_scenario)
app.command("rehearse", cls=EalCommand)(rehearse.rehearse_scenario)
app.command("sweep", cls=EalCommand)(sweep.sweep_scenario)
calibrate.app.command("camera", cls=EalCommand)(calibrate_camera.calibrate_camera)
app.add_typer(calibrate.app, name="calibrate")
app.command("report", cls=EalCommand)(records.report_run)
app.command("diff", cls=EalCommand)(records.diff_runs)
app.command("replay", cls=EalCommand)(records.replay_run)
app.command("check", cls=EalCommand)(check.check_files)
app.command("schema", cls=EalCommand)(check.print_schema)
app.command("world", cls=EalCommand)(world.show_world)
app.command("map", cls=EalCommand)(maps.show_map)
app.command("resources", cls=EalCommand)(resources.list_resources)
app.command("call", cls=EalCommand, context_settings={"ignore_unknown_options": True})(
    call.call_method
)  # -5 is a number
app.command("stitch", cls=EalCommand)(stitch.stitch_frames)
app.command("serve", cls=EalCommand)(serve.serve_robot)
app.command("dashboard", cls=EalCommand)(dashboard.show_dashboard)
app.command("audit", cls=EalCommand)(audit.show_audit)
app.command("top", cls=EalCommand)(top.show_top)
app.command("ping", cls=EalCommand)(ping.ping_robots)
app.command("stop", cls=EalCommand)(stop.stop_robots)
app.command("resume", cls=EalCommand)(stop.resume_robots)
app.command("discover", cls=EalCommand)(discover.discover_robots)
app.command("doctor", cls=EalCommand)(doctor.examine)
app.command("ports", cls=EalCommand)(ports.show_ports)
app.command("router", cls=EalCommand)(router.run_router)
keys_lifetime.app.command("dashboard", cls=EalCommand)(dashboard_keys.make_dashboard_certificate)
keys_lifetime.app.command("operator", cls=EalCommand)(dashboard_keys.make_operator)
app.add_typer(keys_lifetime.app, name="keys")
app.add_typer(plugin.app, name="plugin")
app.add_typer(tracker.app, name="tracker")
app.command("demo-network", cls=EalCommand, hidden=True)(demo_network.demo_network)  # for `make demo-network`
app.command("lab", cls=EalCommand, hidden=True)(lab.run_lab)  # for `make lab`


def main() -> None:
    """Run the program and exit."""
    handle_signals()
    with failsafe_output():
        app(prog_name="eal")
