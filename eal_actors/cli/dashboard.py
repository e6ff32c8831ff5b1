"""`eal dashboard`: a page to watch a fleet by, and to steer it."""

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
    port: Annotated[int, typer.Option(min=0, max=65535, help="Where to listen; 0 for any port that is free.")] = 8080,
    host: Annotated[
        str, typer.Option(help="The address to listen at; 0.0.0.0 for all, then read-only without --token.")
    ] = "127.0.0.1",
    token: Annotated[
        bool, typer.Option("--token", help="Have only those command who open the link with the token.")
    ] = False,
    scenarios: Annotated[
        Path | None,
        typer.Option(
            exists=True,
            file_okay=False,
            show_default="scenarios here, else those that come with eal",
            help="The folder of scenarios that the page can start.",
        ),
    ] = None,
    runs_dir: Annotated[Path, typer.Option(help="Where the folders of runs are made.")] = Path("runs"),
) -> None:
    """Serve a page by which people watch a fleet and steer it, until Ctrl-C or SIGTERM.

    It shows the robots, the arena with live poses, cameras, scenarios and logs. Escape stops every robot. When this
    ends, everything that moves is halted.
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
        out.print("read-only: --token lets those command who have the link", soft_wrap=True)
    out.print(Text("Ctrl-C ends it and halts the robots.", style="dim"), soft_wrap=True)


def _in_real_time(config: FleetConfig) -> FleetConfig:
    """Return a fleet that people can watch: as fast as the machine goes is no pace for them."""
    if config.rate != MAX:
        return config
    stderr().print("the fleet's clock runs at rate 1 here, in place of max", style="dim", soft_wrap=True)
    return replace(config, rate=1.0)


def _scenarios() -> Path:
    here = Path("scenarios")
    return here if here.is_dir() else bundled_path("scenarios")
