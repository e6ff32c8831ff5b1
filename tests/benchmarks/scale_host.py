"""A process that hosts many robots of three resources, and a process that commands them through the network.

Run as `python -m tests.benchmarks.scale_host host|control ROBOTS PORT`. Each writes a line of JSON with what it
measured; a host then serves its robots until its standard input ends.
"""

from __future__ import annotations

import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import pykka

from eal_actors import Fleet, gather
from eal_actors.actors.call import Call
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.processors import sharing_processor
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.session import open_session, robot_config

PLUGINS: Final = Path(__file__).parent / "scale_plugins"
TURNS: Final = 7
PATIENCE_S: Final = 120.0


def fleet_of(robots: int, port: int) -> FleetConfig:
    """Return a fleet whose robots are all served at one port of this machine."""
    entry = {"address": f"tcp/127.0.0.1:{port}", "plugins": {"trio": {}}}
    content = {"version": 1, "name": "scale", "plugin_dirs": [str(PLUGINS)], "robots": {"bot": entry}}
    config = EALConfigManager.of(content, name="scale").fleet
    names = [f"bot{number}" for number in range(1, robots + 1)]
    return replace(config, robots={name: replace(config.robots["bot"], name=name) for name in names})


def without_network(config: FleetConfig) -> FleetConfig:
    """Return the same fleet, in this process."""
    return replace(config, robots={name: replace(robot, address=None) for name, robot in config.robots.items()})


def taken() -> tuple[int, int]:
    """Return the resident set in bytes, and the threads, of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE"), len(list(Path("/proc/self/task").iterdir()))


def median_s(action: Callable[[], object]) -> tuple[float, float]:
    """Return the median seconds of an action, by the wall's clock and by this process's processor time."""
    walls, works = [], []
    for _ in range(TURNS):
        wall_s, work_s = time.perf_counter(), time.process_time()
        action()
        walls.append(time.perf_counter() - wall_s)
        works.append(time.process_time() - work_s)
    return statistics.median(walls), statistics.median(works)


def three(robot: RobotHandle) -> list[Call[Any]]:
    """Call each of the robot's resources."""
    return [robot["Base"].send_cmd("go"), robot["Lamp"].send_cmd("go"), robot["Gauge"].get_value()]


def measured(fleet: Fleet) -> dict[str, float]:
    """Connect a fleet, command all robots, read from all, stop all; return what that takes."""
    memory_bytes, threads = taken()
    start = time.perf_counter()
    fleet.connect(timeout_s=PATIENCE_S)
    end_s = REAL_TIME.now() + PATIENCE_S
    while any(robot.state is not RobotState.READY for robot in fleet.values()) and REAL_TIME.now() < end_s:
        REAL_TIME.sleep(0.01)
    start_s = time.perf_counter() - start
    robots = list(fleet.values())
    for robot in robots:
        robot["Base"].info  # noqa: B018  # raises where a robot did not come
    made = refused = 0

    def gathered(calls: Callable[[RobotHandle], list[Call[Any]]]) -> None:
        nonlocal made, refused
        answers = gather([call for robot in robots for call in calls(robot)], return_exceptions=True).get()
        made += len(answers)
        refused += sum(isinstance(answer, Exception) for answer in answers)

    gathered(lambda robot: [robot["Gauge"].get_value()])  # a new client is known then
    made = refused = 0
    command_s, command_work_s = median_s(lambda: gathered(lambda robot: [robot["Base"].send_cmd("go")]))
    read_s, _ = median_s(lambda: gathered(lambda robot: [robot["Gauge"].get_value()]))
    all_s, _ = median_s(lambda: gathered(three))
    memory_after, threads_after = taken()
    return {
        "start_s": start_s,
        "memory_bytes": memory_after - memory_bytes,
        "threads": threads_after - threads,
        "command_s": command_s,
        "command_work_s": command_work_s,
        "read_s": read_s,
        "all_s": all_s,
        "refused": refused / made,
    }


class _Bare(pykka.ThreadingActor):
    def on_receive(self, message: Any) -> int:
        return 1


def bare_s(robots: int) -> float:
    """Return how long bare Pykka takes to ask an actor for each robot, among as many threads as the robots have."""
    actors = [_Bare.start() for _ in range(4 * robots)]
    try:
        return median_s(lambda: pykka.get_all([actor.ask("go", block=False) for actor in actors[::4]]))[0]
    finally:
        pykka.ActorRegistry.stop_all(block=True)


def host(config: FleetConfig) -> None:
    """Measure the robots in this process, then serve them."""
    reference_s = bare_s(len(config.robots))
    with ExitStack() as stack:
        fleet = Fleet(without_network(config))
        stack.callback(fleet.close)
        sys.stdout.write(json.dumps({**measured(fleet), "bare_s": reference_s}) + "\n")
        session = stack.enter_context(open_session(robot_config(config, "bot1")))
        shared = RobotHost(config.name, session, config.network)
        with sharing_processor(len(config.robots)):  # as serve_together
            shared.launch()
        stack.callback(shared.close, 5.0)
        for robot in fleet.values():
            stack.callback(shared.serve(robot).close)
        sys.stdout.write("up\n")
        sys.stdout.flush()
        sys.stdin.read()


def main() -> None:
    """Host robots, or command them."""
    role, robots, port = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    config = fleet_of(robots, port)
    if role == "host":
        host(config)
    else:
        fleet = Fleet(config)
        try:
            sys.stdout.write(json.dumps(measured(fleet)) + "\n")
        finally:
            fleet.close()


if __name__ == "__main__":
    main()
