"""A fleet waits for all robots of a busy process, one handshake after another."""

from __future__ import annotations

import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.wire.format import keys
from eal_actors.wire.format.messages import Answer, CallHeader
from eal_actors.wire.rpc.server.request_handler import RequestHandler
from tests.benchmarks.network_host import fleet_of, serving
from tests.net.links import free_port

ROBOTS = 9
HANDSHAKE_S = 0.5
"""Together they take longer than a robot has that does not answer at all (3 s)."""


@pytest.mark.slow
def test_robots_whose_turn_comes_late_are_not_taken_for_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = RequestHandler.answer

    def answer_slowly(handler: RequestHandler, method: str, header: CallHeader) -> Answer:
        if method == keys.HELLO:
            REAL_TIME.sleep(HANDSHAKE_S)
        return answer(handler, method, header)

    monkeypatch.setattr(RequestHandler, "answer", answer_slowly)
    port = free_port()
    with serving(ROBOTS, port), Fleet(fleet_of(ROBOTS, port)) as fleet:
        assert {name: robot.state for name, robot in fleet.items()} == dict.fromkeys(fleet, RobotState.READY)
