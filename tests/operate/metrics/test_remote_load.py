"""Waiting calls of a robot in another process, by its answers to pings."""

from __future__ import annotations

from pathlib import Path

from eal_actors.actors.combine import gather
from eal_actors.operate.top.call_statistics import RecentCalls
from eal_actors.operate.top.robot_row import robot_row
from tests.net.links import eventually
from tests.net.rig import Rig


def test_pings_report_waiting_calls_and_their_age(tmp_path: Path) -> None:
    with Rig(tmp_path).served_here() as fleet:
        robot = fleet["r1"]
        assert robot["Gauge"].waiting is None  # its mailbox is not here
        slow = robot["Gauge"].send_req("slow1.5")
        readings = [robot["Gauge"].get_value() for _ in range(3)]
        assert eventually(lambda: dict(robot.ping().get().mailboxes).get("Gauge") is not None)
        assert eventually(lambda: robot.ping().get().mailboxes["Gauge"].count == 3)
        ping = robot.ping().get()
        row = robot_row(robot, RecentCalls(), RecentCalls(), ping)
        assert row.waiting == 3
        assert 0.0 < row.oldest_s < 1.5
        gather([slow, *readings]).get()
        assert robot.ping().get().mailboxes == {}
        assert (row.restarts, ping.restarts) == (0, {})
