"""A ROS 2 robot in a fleet: the driver against a robot that is made with zenoh-ros2-sdk, at a real router."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import BlockedError, DataError, EALError, NotReadyError, UnavailableError
from plugins.ros2.message_types import MessageTypes
from plugins.ros2.session import RosSession
from tests.unit.plugins.ros2.rig import Ros2Peer, SdkRobot, free_port, open_router, ros2_fleet, wait_for

DRIVE = {"drive": {"max_speed_m_s": 1.0, "speed_m_s": 0.5, "turn_rate_deg_s": 90.0}}
CALL_S = 60.0


def until_ready(fleet: Fleet, robot: str, *resources: str) -> None:
    wait_for(lambda: not set(resources) & set(fleet[robot].not_ready), f"{resources}: {dict(fleet[robot].not_ready)}")


def until_not_ready(fleet: Fleet, robot: str, resource: str, reason: str) -> None:
    """Wait for a reason: until the graph has arrived, there is another one."""
    wait_for(lambda: reason in fleet[robot].not_ready.get(resource, ""), f"{resource}: it is not {reason!r}")


def test_it_drives_by_commands_and_to_places(peer: Ros2Peer, tmp_path: Path) -> None:
    """The true path is the robot's own; the twist of the last message is zero after each motion."""
    with (
        SdkRobot(peer, "/turtle") as turtle,
        ros2_fleet(tmp_path, peer, one={"namespace": "/turtle", **DRIVE}) as fleet,
    ):
        base = fleet["one"]["Base"]
        until_ready(fleet, "one", "Base", "Odometry", "Pose")
        assert base.send_cmd("f0.5", timeout_s=CALL_S).get() == 1
        assert turtle.pose[0] == pytest.approx(0.5, abs=0.03)
        assert abs(turtle.pose[1]) < 0.03
        assert base.send_cmd("l90", timeout_s=CALL_S).get() == 1
        assert math.degrees(turtle.turned_rad) == pytest.approx(90, abs=4)
        assert base.send_cmd("goto", [0.5, 0.4], timeout_s=CALL_S).get() == 1
        assert math.dist(turtle.pose[:2], (0.5, 0.4)) < 0.06
        wait_for(lambda: turtle.commands[-1] == (0.0, 0.0), "it is not stopped")
        assert fleet["one"]["Odometry"].get_value().get().value == pytest.approx(
            [*turtle.pose[:2], math.remainder(turtle.pose[2], math.tau)], abs=0.05
        )


def test_a_twist_ends_by_our_watchdog_and_a_halt_stops_at_once(peer: Ros2Peer, tmp_path: Path) -> None:
    with SdkRobot(peer, "/dog") as dog, ros2_fleet(tmp_path, peer, one={"namespace": "/dog", **DRIVE}) as fleet:
        base = fleet["one"]["Base"]
        until_ready(fleet, "one", "Base")
        assert base.set_value([0.3, 0.0], timeout_s=CALL_S).get() == 1  # done when the time-out has passed
        wait_for(lambda: dog.commands[-1] == (0.0, 0.0), "the watchdog did not stop it")
        moving = base.set_value([0.3, 0.2], timeout_s=CALL_S)
        wait_for(lambda: dog.commands[-1] == (0.3, 0.2), "it does not move")
        base.halt().get()
        wait_for(lambda: dog.commands[-1] == (0.0, 0.0), "it was not halted")
        with pytest.raises(EALError):
            moving.get()


def test_silent_odometry_stops_a_motion(peer: Ros2Peer, tmp_path: Path) -> None:
    with SdkRobot(peer, "/mute") as mute, ros2_fleet(tmp_path, peer, one={"namespace": "/mute", **DRIVE}) as fleet:
        base = fleet["one"]["Base"]
        until_ready(fleet, "one", "Base")
        driving = base.send_cmd("f50", timeout_s=CALL_S)
        wait_for(lambda: mute.twist[0] > 0, "it does not move")
        mute.is_silent = True
        with pytest.raises(UnavailableError, match="no message on /mute/odom for"):
            driving.get()
        wait_for(lambda: mute.commands[-1] == (0.0, 0.0), "it is not stopped")


def test_odometry_that_is_not_finite_is_ignored(peer: Ros2Peer, tmp_path: Path) -> None:
    with SdkRobot(peer, "/nan") as robot, ros2_fleet(tmp_path, peer, one={"namespace": "/nan", **DRIVE}) as fleet:
        until_ready(fleet, "one", "Odometry")
        robot.is_silent = True
        robot.publish(math.nan, 0.0, 0.0)
        until_not_ready(fleet, "one", "Odometry", "not finite")
        robot.is_silent = False
        until_ready(fleet, "one", "Odometry")
        assert np.isfinite(fleet["one"]["Pose"].get_value().get().value).all()


def test_topics_of_any_type_and_services(peer: Ros2Peer, tmp_path: Path) -> None:
    string = peer.publisher("/box/chatter", "std_msgs/msg/String")
    heard: list[str] = []
    event = threading.Event()

    def hear(message: Any) -> None:
        heard.append(message.data)
        event.set()

    peer.subscriber("/box/say", "std_msgs/msg/String", hear)
    response = peer.type("std_srvs/srv/SetBool_Response")
    peer.server("/box/lamp", "std_srvs/srv/SetBool", lambda asked: response(success=asked.data, message="lit"))
    settings = {
        "namespace": "box",
        "topics": {
            "Chatter": {"topic": "chatter", "type": "std_msgs/String"},
            "Say": {"topic": "say", "type": "std_msgs/String", "writable": True},
        },
        "services": {"Lamp": {"service": "lamp", "type": "std_srvs/srv/SetBool"}},
    }
    with ros2_fleet(tmp_path, peer, box=settings) as fleet:
        box = fleet["box"]
        until_not_ready(fleet, "box", "Chatter", "no message on /box/chatter yet")
        wait_for(lambda: string.publish(data="hä?") or "Chatter" not in box.not_ready, "nothing arrives")
        assert json.loads(box["Chatter"].get_value().get().value) == {"data": "hä?"}
        until_ready(fleet, "box", "Say", "Lamp")
        box["Say"].set_value('{"data": "hello"}').get()
        assert event.wait(CALL_S)
        assert heard[0] == "hello"
        answer = box["Lamp"].send_req('{"data": true}', timeout_s=CALL_S).get()
        assert json.loads(answer.value) == {"success": True, "message": "lit"}
        for wrong in ("[]", "{", '{"dta": true}'):
            with pytest.raises(EALError, match=r"JSON object|no field 'dta'"):
                box["Lamp"].send_req(wrong, timeout_s=CALL_S).get()


def test_a_ray_that_is_too_near_to_measure_is_no_free_way(peer: Ros2Peer, tmp_path: Path) -> None:
    """REP 117: -inf is too near, inf is nothing, NaN is no measurement."""
    scans = peer.publisher("/box/scan", "sensor_msgs/msg/LaserScan")
    header = peer.type("std_msgs/msg/Header")(
        stamp=peer.type("builtin_interfaces/msg/Time")(sec=0, nanosec=0), frame_id="laser"
    )
    numbers = {"angle_min": 0.0, "angle_max": 0.4, "angle_increment": 0.1, "time_increment": 0.0, "scan_time": 0.0}
    ranges = np.array([-math.inf, 1.5, math.inf, math.nan, 9.0], np.float32)
    settings = {"topics": {"Lidar": {"topic": "/box/scan", "type": "sensor_msgs/msg/LaserScan"}}}
    with ros2_fleet(tmp_path, peer, box=settings) as fleet:

        def scan() -> bool:
            scans.publish(
                header=header, **numbers, range_min=0.25, range_max=8.0, ranges=ranges,
                intensities=np.zeros(0, np.float32),
            )  # fmt: skip
            return "Lidar" not in fleet["box"].not_ready

        wait_for(scan, "nothing arrives")
        assert list(fleet["box"]["Lidar"].get_value().get().value) == [0.25, 1.5, 8.0, 8.0, 8.0]


def test_a_robot_of_another_type_domain_or_absence_is_named(peer: Ros2Peer, tmp_path: Path) -> None:
    peer.publisher("/x/count", "std_msgs/msg/Int32")
    peer.publisher("/x/older", "std_msgs/msg/String", type_hash="RIHS01_" + "0" * 64)
    peer.publisher("/x/elsewhere", "std_msgs/msg/String", domain_id=5)
    names = ("count", "older", "elsewhere")
    topics = {name.title(): {"topic": f"/x/{name}", "type": "std_msgs/msg/String"} for name in names}
    with ros2_fleet(tmp_path, peer, x={"topics": topics}) as fleet:
        until_not_ready(fleet, "x", "Count", "there std_msgs/msg/Int32 (RIHS01_")
        older = "there std_msgs/msg/String (RIHS01_00000000), here std_msgs/msg/String (RIHS01_df668c74)"
        until_not_ready(fleet, "x", "Older", older)
        until_not_ready(fleet, "x", "Elsewhere", "nobody publishes /x/elsewhere in domain 0")
        with pytest.raises(NotReadyError):
            fleet["x"]["Count"].get_value().get()


def test_broken_bytes_long_messages_and_a_flood_harm_only_their_topic(peer: Ros2Peer, tmp_path: Path) -> None:
    """10,000 messages at once, bytes that are no CDR, and a megabyte where 1,000 bytes are read."""
    flood = peer.publisher("/f/flood", "std_msgs/msg/Int32")
    broken = peer.publisher("/f/broken", "nav_msgs/msg/Odometry")
    long = peer.publisher("/f/long", "std_msgs/msg/String")
    topics = {
        "Flood": {"topic": "/f/flood", "type": "std_msgs/Int32"},
        "Broken": {"topic": "/f/broken", "type": "nav_msgs/Odometry"},
        "Long": {"topic": "/f/long", "type": "std_msgs/String", "max_bytes": 1000},
    }
    with ros2_fleet(tmp_path, peer, f={"topics": topics}) as fleet:
        robot = fleet["f"]
        wait_for(lambda: long.publish(data="ok") or "Long" not in robot.not_ready, "nothing arrives")
        for number in range(10_000):
            flood.publish(data=number)
        wait_for(
            lambda: "Flood" not in robot.not_ready and robot["Flood"].get_value().get().value == '{"data": 9999}',
            "the newest message is not there",
        )

        def reason(resource: str) -> str:
            try:
                robot[resource].get_value().get()
            except EALError as error:
                return error.message
            return ""

        wait_for(lambda: broken.pub.put(b"\x00\x01\x00\x00\xff") or "are no nav_msgs" in reason("Broken"), "no error")
        wait_for(lambda: long.publish(data="x" * 10**6) or "max_bytes is 1000" in reason("Long"), "no error")
        assert robot.state is RobotState.READY
        wait_for(lambda: long.publish(data="ok") or reason("Long") == "", "it does not recover")


def test_a_router_that_appears_late_and_goes(tmp_path: Path) -> None:
    """The robot is not ready until the router is there, and again when it goes; nothing blocks."""
    port = free_port()
    topics = {"Say": {"topic": "/say", "type": "std_msgs/String", "writable": True}}
    with ros2_fleet(tmp_path, f"tcp/127.0.0.1:{port}", late={"topics": topics}) as fleet:
        until_not_ready(fleet, "late", "Say", f"cannot reach the zenoh router at tcp/127.0.0.1:{port}")
        router: Any = open_router(port)
        until_ready(fleet, "late", "Say")
        fleet["late"]["Say"].set_value("{}").get()
        router.close()
        wait_for(lambda: "is gone" in fleet["late"].not_ready.get("Say", ""), "the loss is not noticed")
        router = open_router(port)
        until_ready(fleet, "late", "Say")
        router.close()


def test_wrong_settings_are_refused_with_their_place(tmp_path: Path) -> None:
    with pytest.raises(EALError) as caught, ros2_fleet(tmp_path, "udp://x", a={"topics": {}}, b={"domain": 300}):
        pass
    assert "router" in str(caught.value)
    assert "domain" in str(caught.value)


NAV2 = "navigate_to_pose"


@contextmanager
def nav2(peer: Ros2Peer, *, accepts: bool, status: int, holds: bool = False, deaf: int = 0) -> Iterator[dict[str, Any]]:
    """Serve NavigateToPose, by the design document of actions; `holds` answers only after a cancellation.

    So many first cancellations as `deaf` says fail.
    """
    types, seen, cancelled = MessageTypes("jazzy"), dict[str, Any](), threading.Event()
    action = types.action("nav2_msgs/action/NavigateToPose")

    def send_goal(asked: Any) -> dict[str, Any]:
        seen["goal"] = asked
        return {"accepted": accepts}

    def get_result(_: Any) -> dict[str, Any]:
        if holds:
            cancelled.wait(CALL_S)
        return {"status": status, "result": {"error_msg": "a wall"}}

    def cancel_goal(asked: Any) -> dict[str, Any]:
        seen["cancellations"] = seen.get("cancellations", 0) + 1
        if seen["cancellations"] <= deaf:
            raise DataError("not now")
        seen["cancelled"] = bytes(asked.goal_info.goal_id.uuid)
        cancelled.set()
        return {}

    first, second = (RosSession(peer.endpoint, 0) for _ in range(2))  # a held answer must not hold up both
    try:
        node = first.node("/nav", "bt_navigator")
        node.service(f"{NAV2}/_action/send_goal", action.send_goal, send_goal)
        node.service(f"{NAV2}/_action/get_result", action.get_result, get_result)
        kind = types.service("action_msgs/srv/CancelGoal")
        second.node("/nav", "other").service(f"{NAV2}/_action/cancel_goal", kind, cancel_goal)
        yield seen
    finally:
        first.close()
        second.close()


def test_goto_is_a_goal_of_nav2_which_a_halt_cancels(peer: Ros2Peer, tmp_path: Path) -> None:
    settings = {"namespace": "/nav", "drive": {"navigate": NAV2}}
    with SdkRobot(peer, "/nav"), ros2_fleet(tmp_path, peer, one=settings) as fleet:
        base = fleet["one"]["Base"]
        until_ready(fleet, "one", "Base")
        with nav2(peer, accepts=True, status=4) as seen:
            assert base.send_cmd("goto", [1.0, 2.0, math.pi / 2], timeout_s=CALL_S).get() == 1
            pose = seen["goal"].goal.pose
            assert (pose.header.frame_id, pose.pose.position.x, pose.pose.position.y) == ("map", 1.0, 2.0)
            assert pose.pose.orientation.z == pytest.approx(math.sqrt(0.5))
        with nav2(peer, accepts=False, status=4), pytest.raises(UnavailableError, match="refused the goal"):
            base.send_cmd("goto", [1.0, 2.0], timeout_s=CALL_S).get()
        with nav2(peer, accepts=True, status=6), pytest.raises(BlockedError, match="Nav2 gave up: a wall"):
            base.send_cmd("goto", [1.0, 2.0], timeout_s=CALL_S).get()
        with nav2(peer, accepts=True, status=5, holds=True, deaf=2) as seen:
            driving = base.send_cmd("goto", [1.0, -1.0], timeout_s=CALL_S)
            wait_for(lambda: "goal" in seen, "no goal was sent")
            base.halt().get()
            wait_for(lambda: "cancelled" in seen, "the goal was not cancelled")
            assert seen["cancelled"] == bytes(seen["goal"].goal_id.uuid)
            assert seen["goal"].goal.pose.pose.orientation.z == pytest.approx(math.sin(-math.pi / 8))
            with pytest.raises(EALError):
                driving.get()
        with pytest.raises(UnavailableError, match="did not answer"):
            base.send_cmd("goto", [1.0, 2.0], timeout_s=CALL_S).get()
