"""Routers that say nothing, absurd odometry and long messages: a clear state, and the other robots go on."""

from __future__ import annotations

import socket
from pathlib import Path

import numpy as np
import pytest

from eal_actors.kernel.clock import REAL_TIME
from tests.log_lines import log_lines
from tests.unit.plugins.mqtt.rig import error_of
from tests.unit.plugins.ros2.rig import Ros2Peer, SdkRobot, free_port, ros2_fleet, wait_for
from tests.unit.plugins.ros2.test_inward import until_not_ready, until_ready

DRIVE = {"drive": {"speed_m_s": 0.3}}


def test_a_router_that_accepts_and_says_nothing_delays_nobody(tmp_path: Path) -> None:
    port = free_port()
    topics = {"Say": {"topic": "/say", "type": "std_msgs/String", "writable": True}}
    with socket.create_server(("127.0.0.1", port)):
        begin_s = REAL_TIME.now()
        with ros2_fleet(tmp_path, f"tcp/127.0.0.1:{port}", one={"topics": topics}) as fleet:
            until_not_ready(fleet, "one", "Say", f"cannot reach the zenoh router at tcp/127.0.0.1:{port}")
            assert error_of(lambda: fleet["one"]["Say"].set_value("{}").get())
        assert REAL_TIME.now() - begin_s < 30.0


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        ((1e300, 0.0, 0.0), "1,000 km"),
        ((0.0, -1e9, 0.0), "1,000 km"),
        ((0.0, 0.0, 1.0, 0.0), "no rotation"),
        ((0.0, 0.0, 1.0, 1e200), "no rotation"),
    ],
)
def test_absurd_odometry_is_ignored(peer: Ros2Peer, tmp_path: Path, pose: tuple[float, ...], words: str) -> None:
    with SdkRobot(peer, "/odd") as robot, ros2_fleet(tmp_path, peer, one={"namespace": "/odd", **DRIVE}) as fleet:
        until_ready(fleet, "one", "Base")
        robot.is_silent = True

        def is_named() -> bool:
            robot.publish(*pose)
            return words in fleet["one"].not_ready.get("Odometry", "")

        wait_for(is_named, words)
        wait_for(lambda: "Base" in fleet["one"].not_ready, "it is ready")  # follows a moment later
        robot.is_silent = False
        until_ready(fleet, "one", "Base")
        driving = fleet["one"]["Base"].send_cmd("f0.3", timeout_s=60.0)
        while not driving.done():
            robot.publish(*pose)
            REAL_TIME.sleep(0.05)
        assert driving.get() == 1
        assert robot.pose[:2] == pytest.approx((0.3, 0.0), abs=0.05)


def test_good_and_bad_odometry_in_turn_floods_no_log(peer: Ros2Peer, tmp_path: Path) -> None:
    with (
        log_lines() as lines,
        SdkRobot(peer, "/turns") as robot,
        ros2_fleet(tmp_path, peer, one={"namespace": "/turns", **DRIVE}) as fleet,
    ):
        until_ready(fleet, "one", "Odometry")
        for _ in range(100):
            robot.publish(1e300, 0.0, 0.0)
            REAL_TIME.sleep(0.05)
        wait_for(lambda: "odometry is ignored" in lines.getvalue(), "it is not said")
        assert lines.getvalue().count("odometry is ignored") < 25


def test_a_megabyte_as_json_delays_no_other_robot(peer: Ros2Peer, tmp_path: Path) -> None:
    cloud = peer.publisher("/big/points", "std_msgs/msg/UInt8MultiArray")
    text = peer.publisher("/small/text", "std_msgs/msg/String")
    big = {"topics": {"Points": {"topic": "/big/points", "type": "std_msgs/UInt8MultiArray"}}}
    small = {"topics": {"Text": {"topic": "/small/text", "type": "std_msgs/String"}}}
    layout = peer.type("std_msgs/msg/MultiArrayLayout")(dim=[], data_offset=0)
    data = np.zeros(1 << 20, np.uint8)
    with ros2_fleet(tmp_path, peer, big=big, small=small) as fleet:

        def points() -> str:
            cloud.publish(layout=layout, data=data)
            return error_of(lambda: fleet["big"]["Points"].get_value().get())

        wait_for(lambda: text.publish(data="ok") or "Text" not in fleet["small"].not_ready, "nothing arrives")
        wait_for(lambda: "characters as JSON" in points(), "no error")
        slowest_s = 0.0
        for _ in range(20):
            asked = fleet["big"]["Points"].get_value()
            begin_s = REAL_TIME.now()
            assert fleet["small"]["Text"].get_value().get().value == '{"data": "ok"}'
            slowest_s = max(slowest_s, REAL_TIME.now() - begin_s)
            assert "characters as JSON" in error_of(asked.get)
        assert slowest_s < 2.0
