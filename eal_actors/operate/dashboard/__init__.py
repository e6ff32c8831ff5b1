"""The dashboard: one page by which people watch a fleet, and steer it.

    with Fleet.load("fleets/sim.yaml") as fleet, Dashboard(fleet) as dashboard:
        print(dashboard.link)

The fleet's side and the browsers' side meet in the `Hub`, a plain object that keeps the newest state and counts what
changed. Threads of the fleet's side (`watcher`, `cameras`, `steering`) write into it and never wait for anybody. Each
browser (`browser`, in the thread of the web server) reads at its own pace what is new to it. So a browser that stops
reading costs the memory of one message, and holds up nobody.
"""

from eal_actors.operate.dashboard.access import Access
from eal_actors.operate.dashboard.server import Dashboard

__all__ = ["Access", "Dashboard"]
