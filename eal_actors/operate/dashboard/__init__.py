"""The dashboard: a web page to watch and control a fleet.

    with Fleet.load("fleets/sim.yaml") as fleet, Dashboard(fleet) as dashboard:
        print(dashboard.link)

Threads that poll the fleet (`fleet_poller`, `cameras`, `teleop`) write into the `StateStore`, a plain object with the
newest state, and never wait for a browser. Each `BrowserSession`, in the thread of the web server, reads changes from
it at the pace of its browser. So a browser that stops reading costs the memory of one message and delays nobody.

The web server's packages are imported when `Dashboard` is first used: other views use only the parts without them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from eal_actors.operate.dashboard.access import Access
    from eal_actors.operate.dashboard.log_tap import LogTap
    from eal_actors.operate.dashboard.server import Dashboard
    from eal_actors.operate.dashboard.web_server import tls_context

__all__ = ["Access", "Dashboard", "LogTap", "tls_context"]

_MODULES: Final = {"Access": "access", "Dashboard": "server", "LogTap": "log_tap", "tls_context": "web_server"}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
