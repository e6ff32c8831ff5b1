"""Serve this machine's robot like `eal serve`, without loading the command line, because boards are slow.

The robot is the one in the file `name` next to it, else the only one with an address, else the one with the
machine's host name.
"""

from __future__ import annotations

import signal
import socket
import sys
from pathlib import Path
from types import FrameType
from typing import Final, NoReturn

from robot_user import Own  # type: ignore[import-not-found]  # beside this file in the image

from eal_actors.facade.service import RobotService
from eal_actors.kernel.errors import ConfigError, EALError, Problem
from eal_actors.kernel.log import configure_logging
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig

_STATE: Final = Path("/run/evbotos")


def choose_robot(config: FleetConfig, fleet: Path, hostname: str) -> str:
    """Return the name of this machine's robot.

    Raises:
        ConfigError: the choice is ambiguous.
    """
    name = fleet.with_name("name")
    if name.is_file():
        return name.read_text().strip()
    served = [robot.name for robot in config.robots.values() if robot.address is not None]
    if len(served) == 1:
        return served[0]
    if hostname in served:
        return hostname
    message = f"which of {', '.join(served) or 'no robots'} is this machine, {hostname}? Write it into {name}"
    raise ConfigError([Problem(str(fleet), 0, 0, "robots", message)])


def _interrupt(_number: int, _frame: FrameType | None) -> NoReturn:
    raise KeyboardInterrupt


def serve(own: Own) -> None:
    """Serve until SIGTERM.

    Raises:
        EALError: the robot cannot be served.
    """
    config = EALConfigManager.load(own.fleet).fleet
    robot = choose_robot(config, own.fleet, socket.gethostname())
    with RobotService(config, robot) as service:
        uptime_s = Path("/proc/uptime").read_text().split()[0]
        (_STATE / "robot.up").write_text(f"{robot} {own.source} {uptime_s}\n")
        resources = ", ".join(service.robot)
        place = ", ".join(service.endpoints)
        own.say(f"{robot} of {own.source} serves {resources} at {place}, {uptime_s} s after the start")
        service.wait()


def main(own: Own) -> None:
    """Serve and report errors.

    Args:
        own: the fleet file and the console.
    """
    configure_logging("human", "info")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _interrupt)
    try:
        serve(own)
    except KeyboardInterrupt:
        sys.stderr.write("halted; leaving the network\n")
    except EALError as error:
        own.say(f"the robot does not start: {error}")
        raise SystemExit(1) from None
    except Exception as error:
        own.say(f"the robot crashed with {type(error).__name__}: {error}")
        raise  # the log has the traceback
