"""The dashboard: a web page to watch and control a fleet.

    with Fleet.load("fleets/sim.yaml") as fleet, Dashboard(fleet) as dashboard:
        print(dashboard.link)

Threads that poll the fleet (`fleet_poller`, `cameras`, `teleop`) write into the `StateStore`, a plain object with the
newest state, and never wait for a browser. Each `BrowserSession`, in the thread of the web server, reads changes from
it at the pace of its browser. So a browser that stops reading costs the memory of one message and delays nobody.
"""

from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.server import Dashboard
from eal_actors.operate.dashboard.web_server import tls_context

__all__ = ["Access", "Dashboard", "tls_context"]
