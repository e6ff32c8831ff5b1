"""A process that serves many robots like the only one of a fleet file, at its port.

Run as `python -m tests.net.host FLEET ROBOTS`.
"""

from __future__ import annotations

import signal
import sys
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from eal_actors import Fleet
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.session import open_session, robot_config


def crowd(config: FleetConfig, robots: int) -> FleetConfig:
    """Return a fleet of so many robots like the only one of another fleet."""
    (model,) = config.robots.values()
    return replace(config, robots={name: replace(model, name=name) for name in (f"r{n + 1}" for n in range(robots))})


def main() -> None:
    """Serve until the process is killed."""
    config = crowd(EALConfigManager.load(Path(sys.argv[1])).fleet, int(sys.argv[2]))
    with ExitStack() as stack:
        local = {name: replace(robot, address=None, listen=None) for name, robot in config.robots.items()}
        fleet = stack.enter_context(Fleet(replace(config, robots=local)))
        session = stack.enter_context(open_session(robot_config(config, "r1")))
        host = RobotHost(config.name, session, config.network).launch()
        stack.callback(host.close, 5.0)
        for robot in fleet.values():
            stack.callback(host.serve(robot).close)
        sys.stdout.write("listening at its port\n")
        sys.stdout.flush()
        signal.pause()


if __name__ == "__main__":
    main()
