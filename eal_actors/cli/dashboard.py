"""`eal dashboard`: a web page to watch and control a fleet."""

from __future__ import annotations

import ssl
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.fleets import in_real_time, read_fleet
from eal_actors.cli.interrupts import handle_signals
from eal_actors.cli.live_view import FoxgloveControlOption, FoxgloveOption, foxglove_at
from eal_actors.cli.options import FleetOption
from eal_actors.cli.output import service_output
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import REAL_TIME, new_waiter
from eal_actors.kernel.errors import file_error
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.keys.certificates import DASHBOARD, certificate_file, folder_of, key_file, list_certificates
from eal_actors.managers.missing_modules import needs_extra, require_modules

if TYPE_CHECKING:
    from eal_actors.operate.dashboard import Dashboard

_MAKE_CERTIFICATE: Final = "`eal keys dashboard`"


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
    foxglove: FoxgloveOption = None,
    foxglove_control: FoxgloveControlOption = False,
) -> None:
    """Serve a web page to watch and control a fleet, until Ctrl-C or SIGTERM.

    The page shows the robots, a map with live poses, cameras, scenarios and logs. Escape stops every robot. At the end
    all robots are halted. `eal keys dashboard` makes the certificate with which the page is served by HTTPS, and
    `eal keys operator` the tokens of users with names and roles; `eal audit` shows what they commanded.
    """
    with needs_extra("dashboard", "the dashboard needs"):
        from eal_actors.managers.network_model import is_loopback
        from eal_actors.operate.dashboard import Access, Dashboard, LogTap
        from eal_actors.operate.dashboard.tokens import new_token
    handle_signals()
    config = in_real_time(read_fleet(fleet))
    if token and config.operators:
        raise typer.BadParameter("the fleet file names operators, who have tokens already", param_hint="--token")
    tls, names = _tls(config)
    access = Access(host, new_token() if token else None, config.operators, names)
    if config.operators and tls is None and not is_loopback(host):
        why = f"operators' tokens must not pass a network unencrypted: make a certificate with {_MAKE_CERTIFICATE}"
        raise file_error(f"{host}:{port}", why)
    require_modules(config, config.robots)
    with LogTap() as log, Fleet(config).connect() as opened:
        folders = {"scenarios": scenarios or _scenarios(), "runs_dir": runs_dir, "keys": folder_of(config)}
        page = Dashboard(opened, access, log=log, port=port, tls=tls, **folders)
        out = service_output()
        with foxglove_at(foxglove, opened, out, allow_control=foxglove_control), page:
            try:
                _announce(page, config.name, out)
                if tls is None and not is_loopback(host):
                    out.print(f"not encrypted: {_MAKE_CERTIFICATE} makes a certificate for HTTPS", soft_wrap=True)
                REAL_TIME.wait(new_waiter(), None)
            except KeyboardInterrupt:
                out.print("halting the robots")


def _announce(page: Dashboard, fleet: str, out: Console) -> None:
    out.print(Text.assemble((fleet, "bold"), f": {page.link}"), soft_wrap=True)
    access = page.access
    if not (access.is_open or access.token or access.operators):
        out.print("read-only: use --token for a link that permits commands", soft_wrap=True)
    out.print(Text("Press Ctrl-C to halt the robots and quit.", style="dim"), soft_wrap=True)


def _tls(config: FleetConfig) -> tuple[ssl.SSLContext | None, Sequence[str]]:
    """Return the context of HTTPS and the host names of its certificate; neither if `eal keys` made none."""
    from eal_actors.operate.dashboard import tls_context

    folder = folder_of(config)
    certificate = certificate_file(folder, DASHBOARD)
    if not certificate.is_file():
        return None, ()
    names = [found.hosts for found in list_certificates(folder) if found.name == DASHBOARD]
    return tls_context(certificate, key_file(folder, DASHBOARD)), names[0]


def _scenarios() -> Path:
    here = Path("scenarios")
    return here if here.is_dir() else bundled_path("scenarios")
