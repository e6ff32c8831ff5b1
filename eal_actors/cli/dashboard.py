"""`eal dashboard`: a web page to watch and control a fleet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import stderr, stdout
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.kernel.lock_step import MAX
from eal_actors.managers.fleet_model import FleetConfig

if TYPE_CHECKING:
    from eal_actors.operate.dashboard import Dashboard


def show_dashboard(
    fleet: FleetOption,
    port: Annotated[int, typer.Option(min=0, max=65535, help="The port; 0 for any free port.")] = 8080,
    host: Annotated[
        str, typer.Option(help="The address to listen at; 0.0.0.0 for all addresses, read-only without --token.")
    ] = "127.0.0.1",
    token: Annotated[bool, typer.Option("--token", help="Require the token in the printed link for commands.")] = False,
    scenarios: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            show_default="./scenarios, else the bundled scenarios",
            help="The folder of scenarios that the page can start.",
        ),
    ] = None,
    runs_dir: Annotated[Path, typer.Option(help="The folder for the runs' records.")] = Path("runs"),
) -> None:
    """Serve a web page to watch and control a fleet, until Ctrl-C or SIGTERM.

    The page shows the robots, a map with live poses, cameras, scenarios and logs. Escape stops every robot. At the end
    all robots are halted.
    """
    try:
        from eal_actors.operate.dashboard import Access, Dashboard
        from eal_actors.operate.dashboard.access import new_token
    except ModuleNotFoundError as error:
        raise UnsupportedError(
            f"the dashboard needs {error.name}, which is not installed: pip install 'eal-actors[dashboard]'"
        ) from error
    handle_signals()
    config = _in_real_time(read_fleet(fleet))
    access = Access(host, new_token() if token else None)
    with Fleet(config).connect() as opened:
        page = Dashboard(opened, access, port=port, scenarios=scenarios or _scenarios(), runs_dir=runs_dir)
        with page:
            out = stdout()
            try:
                _announce(page, config.name, out)
                REAL_TIME.wait(new_waiter(), None)
            except KeyboardInterrupt:
                out.print("halting the robots")


def _announce(page: Dashboard, fleet: str, out: Console) -> None:
    out.print(Text.assemble((fleet, "bold"), f": {page.link}"), soft_wrap=True)
    if page.access.refusal(page.access.token) is not None:
        out.print("read-only: use --token for a link that permits commands", soft_wrap=True)
    out.print(Text("Press Ctrl-C to halt the robots and quit.", style="dim"), soft_wrap=True)


def _in_real_time(config: FleetConfig) -> FleetConfig:
    """Return the fleet with a rate that people can follow."""
    if config.rate != MAX:
        return config
    stderr().print("the fleet's clock runs at rate 1 instead of max", style="dim", soft_wrap=True)
    return replace(config, rate=1.0)


def _scenarios() -> Path:
    here = Path("scenarios")
    return here if here.is_dir() else bundled_path("scenarios")
