"""Tokens of many robots that are there before their controller."""

from __future__ import annotations

import threading

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.format import keys
from eal_actors.wire.session import controller_config, open_session, robot_config
from eal_actors.wire.transport import Transport
from tests.benchmarks.network_host import fleet_of
from tests.net.links import free_port
from tests.robots import WAIT_S

ROBOTS = 100


def test_a_controller_hears_of_many_robots_that_are_present() -> None:
    fleet = fleet_of(ROBOTS, free_port())
    every = keys.alive_key(fleet.network_name, None)
    with open_session(robot_config(fleet, "bot1")) as robots, open_session(controller_config(fleet)) as controller:
        tokens = [robots.liveliness().declare_token(keys.alive_key(fleet.network_name, name)) for name in fleet.robots]
        end_s = REAL_TIME.now() + WAIT_S
        while len(list(controller.liveliness().get(every))) < ROBOTS:  # from now on it knows them
            assert REAL_TIME.now() < end_s
        heard, are_all = set[str](), threading.Event()

        def hear(key: str, _: object) -> None:
            heard.add(key)
            if len(heard) == ROBOTS:
                are_all.set()

        listening = threading.Thread(
            target=lambda: Transport(controller).receive_tokens(every, "presence", hear), daemon=True
        )
        listening.start()
        listening.join(WAIT_S)
        assert not listening.is_alive()
        assert are_all.wait(WAIT_S)
        del tokens
