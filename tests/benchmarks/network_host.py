"""A process that serves many robots behind one endpoint, beside bare zenoh queryables that answer the same.

Run as `python -m tests.benchmarks.network_host ROBOTS PORT [BARE_PORT [CPU]]`; it says `up`, and ends with its standard
input. The bare engine has a session of its own, as it comes.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceType
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.processors import sharing_processor, take_turns
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.rpc.server.host import RobotHost
from eal_actors.wire.session import open_session, robot_config
from tests.robots import running_robot

if TYPE_CHECKING:
    import zenoh

FRAME: Final = np.zeros((480, 640, 3), dtype=np.uint8)
VIEW: Final = np.zeros((120, 160, 3), dtype=np.uint8)
VALUE: Final = bytes(24)
ENVELOPE: Final = bytes(40)


class Lamp(Resource):
    """A light that can be switched, and flashes for a while."""

    types = ResourceType.ACTUATOR

    def get_value(self) -> EALData:
        return EALData.of(1.0, stamp_s=0.0)

    @command("on")
    def on(self) -> int:
        """Switch it on."""
        return 1

    @command("flash")
    def flash(self) -> Activity:
        """Flash for a minute."""
        yield 60.0
        return 1


class Eye(Resource):
    """A camera that always sees the same."""

    types = ResourceType.SENSOR
    sees = FRAME

    def get_value(self) -> EALData:
        return EALData.of(self.sees)


class SmallEye(Eye):
    """One with fewer pixels."""

    sees = VIEW


def fleet_of(robots: int, port: int) -> FleetConfig:
    """Return a fleet whose robots are all served at one port of this machine."""
    endpoint = f"tcp/127.0.0.1:{port}"
    content = {"version": 1, "robots": {"bot1": {"address": endpoint, "plugins": {"sample": {}}}}}
    config = EALConfigManager.of(content, name="crowd").fleet
    first = config.robots["bot1"]
    names = [f"bot{number}" for number in range(1, robots + 1)]
    return replace(config, robots={name: replace(first, name=name) for name in names})


def bare_config(*, listen: int | None = None, connect: int | None = None) -> zenoh.Config:
    """Return the configuration of a bare session: what zenoh does by itself between two machines.

    On one it would hand frames over in shared memory.
    """
    import zenoh

    def endpoints(port: int | None) -> dict[str, list[str]]:
        return {"endpoints": [] if port is None else [f"tcp/127.0.0.1:{port}"]}

    config = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "listen": endpoints(listen),
        "connect": endpoints(connect),
        "transport": {"shared_memory": {"enabled": False}},
    }
    return zenoh.Config.from_json5(json.dumps(config))


@contextmanager
def serving(robots: int, port: int) -> Iterator[None]:
    """Serve robots at a port."""
    config = fleet_of(robots, port)
    take_turns()  # as serve_together
    with ExitStack() as stack:
        session = stack.enter_context(open_session(robot_config(config, "bot1")))
        host = RobotHost(config.name, session, config.network)
        stack.enter_context(sharing_processor(robots))
        host.launch()
        stack.callback(host.close, 5.0)
        for name in config.robots:
            made: dict[str, Callable[[], Resource]] = {"Lamp": Lamp}
            if robots <= 100:
                made["Eye"] = Eye if robots == 1 else SmallEye
            robot = stack.enter_context(running_robot(made, name=name, clock=SystemClock()))
            server = host.serve(robot)
            stack.callback(server.close)
        yield


def main() -> None:
    """Serve until the standard input ends."""
    import zenoh

    robots, port = int(sys.argv[1]), int(sys.argv[2])
    if len(sys.argv) > 4:
        os.sched_setaffinity(0, {int(sys.argv[4])})
    with ExitStack() as stack:
        stack.enter_context(serving(robots, port))

        def answer(query: zenoh.Query) -> None:
            key = str(query.key_expr)
            with query:
                query.reply(key, FRAME.tobytes() if key.endswith("frame") else VALUE, attachment=ENVELOPE, express=True)

        if len(sys.argv) > 3:
            bare = stack.enter_context(zenoh.open(bare_config(listen=int(sys.argv[3]))))
            for number in range(robots):
                bare.declare_queryable(f"bare/{number}/**", zenoh.handlers.Callback(answer, indirect=False))
        sys.stdout.write("up\n")
        sys.stdout.flush()
        sys.stdin.read()


if __name__ == "__main__":
    main()
