"""Fleets and robots that several EAL connections of one process share: three connects must meet in one simulation."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.fleet import Fleet


@dataclass
class _Shared:
    fleet: Fleet
    users: int = 0


_lock = threading.Lock()
_fleets: dict[Path | str, _Shared] = {}
_connections: Counter[RobotHandle] = Counter()


def acquire_fleet(path: Path) -> Fleet:
    """Return the process's fleet of that file, connected; each call wants one `release_fleet`.

    Raises:
        ConfigError: what is wrong with the file.

    Thread: any; blocks while the fleet connects.
    """
    return _acquire(path.resolve(), lambda: Fleet.load(path))


def acquire_fleet_at(endpoint: str, make: Callable[[], Fleet]) -> Fleet:
    """Return the process's fleet of one robot at an endpoint, connected; each call wants one `release_fleet`.

    Args:
        endpoint: where the robot is.
        make: makes the fleet, if there is none yet.

    Thread: any; blocks while the fleet connects.
    """
    return _acquire(endpoint, make)


def _acquire(key: Path | str, make: Callable[[], Fleet]) -> Fleet:
    with _lock:
        if key not in _fleets:
            _fleets[key] = _Shared(make().connect())
        shared = _fleets[key]
        shared.users += 1
        return shared.fleet


def release_fleet(fleet: Fleet) -> None:
    """Give back one `acquire_fleet`; the last one closes the fleet. Thread: any; may block while it closes."""
    with _lock:
        for key, shared in list(_fleets.items()):
            if shared.fleet is fleet:
                shared.users -= 1
                if shared.users == 0:
                    del _fleets[key]
                    fleet.close()


def occupy(robot: RobotHandle) -> None:
    """Note a connection to a robot; each wants one `vacate`. Thread: any."""
    with _lock:
        _connections[robot] += 1


def vacate(robot: RobotHandle) -> None:
    """Note the end of a connection; the last one halts the robot. Thread: any; waits until it has halted."""
    with _lock:
        _connections[robot] -= 1
        is_last = _connections[robot] <= 0
        if is_last:
            del _connections[robot]
    if is_last:
        robot.halt().exception()  # as far as it still can
