"""Replies that a full or broken link does not deliver reach their callers nevertheless."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.wire.rpc.server.outbox import Outbox
from eal_actors.wire.session import controller_config, open_session, robot_config, router_config
from eal_actors.wire.transport import Transport
from tests.net.links import Wire, eventually, fleet_of, free_port
from tests.net.rig import WAIT_S, Rig, ready, servers

PIECE = 30_000
MOST_PIECES = 5_000
PIECES = 400
"""More than the buffers of a link hold."""
PAUSE_S = 0.001
"""Between two replies, so that the robot's own link is never full."""
PATIENT_US = 60_000_000
"""How long the engine lets a message wait for a full link before it closes it."""


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def patient(config: dict[str, Any]) -> dict[str, Any]:
    """Return a session's configuration whose links outlast a test that a busy machine delays."""
    config["transport"]["link"]["tx"]["queue"] = {"congestion_control": {"block": {"wait_before_close": PATIENT_US}}}
    return config


class Line:
    """An outbox and the controller that hears it, with a link between them that can be held.

    Args:
        stack: ends all of it.
        is_routed: whether a router relays; the link is then the one between it and the controller.
    """

    def __init__(self, stack: ExitStack, *, is_routed: bool) -> None:
        self._key = "eal/f/test"
        self.sent = set[bytes]()
        self.heard = set[bytes]()
        port = free_port()
        self.wire = Wire(port)
        stack.callback(self.wire.close)
        here, there = (f"tcp/127.0.0.1:{number}" for number in (port, self.wire.port))
        robots = [self._fleet(place, is_routed=is_routed) for place in (here, there)]
        if is_routed:
            stack.enter_context(open_session(patient(router_config([here], fleet=robots[0]))))
        robot = stack.enter_context(open_session(patient(robot_config(robots[0], "r1"))))
        controller = Transport(stack.enter_context(open_session(controller_config(robots[1]))))
        stack.callback(controller.receive(self._key, "listener", self._hear))
        self.outbox = Outbox("outbox", Transport(robot)).launch()
        stack.callback(self.outbox.end_soon)
        assert eventually(self._is_connected)
        assert eventually(lambda: not self.outbox.unsent)

    def _fleet(self, place: str, *, is_routed: bool) -> FleetConfig:
        network = {"discovery": False, "lease_s": 30.0, **({"routers": [place]} if is_routed else {})}
        return fleet_of(network, {"r1": "router" if is_routed else place})

    def _hear(self, _: str, __: bytes, payload: bytes) -> None:
        self.heard.add(payload[:8])

    def _is_connected(self) -> bool:
        self.outbox.publish(self._key, b"", b"begin".ljust(8))
        return bool(self.heard)

    def reply(self) -> None:
        """Send another reply."""
        number = f"{len(self.sent):8}".encode()
        self.sent.add(number)
        self.outbox.publish_briefly(self._key, b"", number.ljust(PIECE))

    def is_complete(self) -> bool:
        """Wait until the controller has all replies; return whether it gets them."""
        return eventually(lambda: self.heard >= self.sent)


def test_a_reply_that_a_full_link_drops_is_sent_again(stack: ExitStack) -> None:
    line = Line(stack, is_routed=False)
    line.wire.hold()
    while not line.outbox.unsent and len(line.sent) < MOST_PIECES:
        line.reply()
    assert line.outbox.unsent, "the link was never full"
    line.wire.flow()
    assert line.is_complete(), sorted(line.sent - line.heard)


def test_a_router_drops_no_reply(stack: ExitStack) -> None:
    line = Line(stack, is_routed=True)
    line.wire.hold()
    for _ in range(PIECES):
        line.reply()
        REAL_TIME.sleep(PAUSE_S)
    line.wire.flow()
    assert line.is_complete(), sorted(line.sent - line.heard)


def test_outcomes_of_a_full_mailbox_outlast_a_cut_link(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    wire = Wire(int(rig.content["robots"]["r1"]["address"].rpartition(":")[2]))
    try:
        with servers(rig):
            rig.content["robots"]["r1"]["address"] = f"tcp/127.0.0.1:{wire.port}"
            rig.write()
            with ready(Fleet(rig.config)) as fleet:
                arm = fleet["r1"]["Arm"]
                wire.hold()
                steps = [arm.send_cmd(f"step{number}", timeout_s=WAIT_S) for number in range(200)]
                assert eventually(lambda: len(rig.steps()) == len(steps))
                wire.cut()
                assert [step.get(timeout=WAIT_S) for step in steps] == list(range(len(steps)))
    finally:
        wire.close()
    assert rig.never_twice()
