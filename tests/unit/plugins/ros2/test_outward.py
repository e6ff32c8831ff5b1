"""`eal bridge ros2`: simulated robots as ROS 2 nodes, seen and driven by zenoh-ros2-sdk."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner
from zenoh_ros2_sdk import discovery

from eal_actors import Fleet
from eal_actors.cli.app import app
from eal_actors.facade.service import RobotService
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.plugins import EALPluginManager
from tests.log_lines import log_lines
from tests.unit.plugins.ros2.rig import Ros2Peer, free_port, wait_for

ROBOTS = {
    "evbot2-1": {"plugins": {"sim": {"model": "evbot2", "lidar": {"rays": 90, "max_range_m": 1.5}}}},
    "roomba-1": {"plugins": {"sim": {"model": "roomba", "start": {"x_m": 1.0, "y_m": 0.5, "yaw_deg": 90}}}},
}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.yaml"
    path.write_text(json.dumps({"version": 1, "name": "two", "robots": ROBOTS}))
    return path


def test_robots_are_seen_and_driven_with_a_dead_man(peer: Ros2Peer, file: Path) -> None:
    """The true path is the simulation's."""
    seen: dict[str, Any] = {}

    def keep(name: str) -> Any:
        return lambda message: seen.__setitem__(name, message)

    with Fleet.load(file) as fleet:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint, "rate_hz": 20})
        with bridge.open_bridge(fleet, settings) as line:
            assert line.startswith("2 nodes, ")
            peer.subscriber("/roomba_1/odom", "nav_msgs/msg/Odometry", keep("odom"))
            peer.subscriber("/evbot2_1/scan", "sensor_msgs/msg/LaserScan", keep("scan"))
            peer.subscriber("/tf", "tf2_msgs/msg/TFMessage", keep("tf"))
            peer.subscriber("/roomba_1/battery_state", "sensor_msgs/msg/BatteryState", keep("battery"))
            peer.subscriber("/evbot2_1/camera/image_raw", "sensor_msgs/msg/Image", keep("image"))
            wait_for(lambda: {"odom", "scan", "tf", "battery", "image"} <= set(seen), f"only {set(seen)} arrived")
            assert len(seen["scan"].ranges) == 90
            assert seen["scan"].range_max == pytest.approx(1.5)
            hits = [range_m for range_m in seen["scan"].ranges if range_m <= seen["scan"].range_max]
            assert 0 < len(hits) < 90
            assert {range_m for range_m in seen["scan"].ranges if range_m not in hits} == {math.inf}  # REP 117
            assert (seen["image"].encoding, seen["image"].step) == ("rgb8", 3 * seen["image"].width)
            assert 0 < seen["battery"].percentage <= 1
            topics = dict(discovery.get_topic_names_and_types(router_port=peer.port))
            assert topics["/roomba_1/cmd_vel"] == ["geometry_msgs/msg/Twist"]
            assert topics["/evbot2_1/scan"] == ["sensor_msgs/msg/LaserScan"]

            truth = fleet["roomba-1"]["TruePose"]
            begin = truth.get_value().get().value
            vector, commands = peer.type("geometry_msgs/msg/Vector3"), peer.publisher(
                "/roomba_1/cmd_vel", "geometry_msgs/msg/Twist"
            )  # fmt: skip

            def drive(speed: float) -> bool:
                commands.publish(linear=vector(x=speed, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))
                return False

            def gone_m() -> float:
                return math.dist(truth.get_value().get().value[:2], begin[:2])

            wait_for(lambda: drive(0.2) or gone_m() > 0.1, "it does not move")
            wait_for(
                lambda: drive(0.2) or 0.15 < seen["odom"].twist.twist.linear.x < 0.25, "its odometry has no velocity"
            )
            wait_for(lambda: fleet["roomba-1"]["Base"].get_status().get() == 0, "it does not stop when they cease")
            stopped_m = gone_m()
            for wrong in (math.nan, math.inf, 1e9):
                drive(wrong)
            odom = seen["odom"].pose.pose.position
            wait_for(lambda: seen["odom"].twist is not None and gone_m() == pytest.approx(stopped_m), "it moved on")
            assert math.hypot(odom.x, odom.y) > 0


def test_robots_follow_stamped_velocities_if_the_settings_say_so(peer: Ros2Peer, file: Path) -> None:
    with Fleet.load(file) as fleet:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint, "stamped": True})
        with bridge.open_bridge(fleet, settings):
            commands = peer.publisher("/roomba_1/cmd_vel", "geometry_msgs/msg/TwistStamped")
            stamp = peer.type("builtin_interfaces/msg/Time")(sec=0, nanosec=0)
            header = peer.type("std_msgs/msg/Header")(stamp=stamp, frame_id="")
            vector = peer.type("geometry_msgs/msg/Vector3")
            ahead, still = vector(x=0.2, y=0.0, z=0.0), vector(x=0.0, y=0.0, z=0.0)
            twist = peer.type("geometry_msgs/msg/Twist")(linear=ahead, angular=still)

            def moves() -> bool:
                commands.publish(header=header, twist=twist)
                return fleet["roomba-1"]["Base"].get_status().get() == 1

            wait_for(moves, "it does not move")


def test_the_path_of_a_motion_is_shown_until_it_ends(peer: Ros2Peer, file: Path) -> None:
    """Points and headings are those of the command; the first one is where the robot was."""
    plans: list[Any] = []
    with Fleet.load(file) as fleet:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint})
        with bridge.open_bridge(fleet, settings):
            peer.subscriber("/roomba_1/plan", "nav_msgs/msg/Path", plans.append)
            wait_for(lambda: bool(plans), "no path arrived")
            assert len(plans[-1].poses) == 0
            driving = fleet["roomba-1"]["Base"].send_cmd("follow", [1.0, 9.5, -8.0, 9.5])
            wait_for(lambda: len(plans[-1].poses) > 0, "the path is not shown")
            poses = [one.pose for one in plans[-1].poses]
            assert [pose.position.x for pose in poses] == pytest.approx([1.0, 1.0, -8.0])
            assert [pose.position.y for pose in poses] == pytest.approx([0.5, 9.5, 9.5])
            yaws = [2 * math.atan2(pose.orientation.z, pose.orientation.w) for pose in poses]
            assert yaws == pytest.approx([math.pi / 2, math.pi, math.pi])
            assert plans[-1].header.frame_id == plans[-1].poses[0].header.frame_id == "map"
            driving.cancel()
            wait_for(lambda: len(plans[-1].poses) == 0, "the path stays")


def test_robots_that_would_be_one_node_are_refused(tmp_path: Path) -> None:
    robots = {name: {"plugins": {"sim": {"model": "roomba"}}} for name in ("cart-1", "cart_1")}
    file = tmp_path / "fleet.yaml"
    file.write_text(json.dumps({"version": 1, "robots": robots}))
    done = CliRunner().invoke(app, ["bridge", "ros2", "--fleet", str(file)])
    assert done.exit_code != 0
    assert "cart-1 and cart_1 would both be the node /cart_1" in " ".join(done.output.split())


@pytest.mark.slow
def test_the_command_runs_until_it_is_interrupted(peer: Ros2Peer, file: Path) -> None:
    command = [sys.executable, "-m", "eal_actors", "bridge", "ros2", "--fleet", str(file)]
    command += ["--setting", f"router={peer.endpoint}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert "nodes" in process.stdout.readline()

        def nodes() -> set[str]:
            return {name for name, _ in discovery.get_topic_names_and_types(router_port=peer.port)}

        wait_for(lambda: "/roomba_1/odom" in nodes(), "its nodes are not in the graph")
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 0
    wait_for(lambda: "/roomba_1/odom" not in nodes(), "its nodes stay in the graph")


def test_wrong_bridges_and_settings_are_named(file: Path) -> None:
    for arguments, problem in (
        (["sim"], "no plugin 'sim' brings a bridge; those that do: ros2, vda5050"),
        (["ros2", "--setting", "domain=999"], "domain: "),
        (["ros2", "--setting", "rate=1"], "rate: "),
    ):
        done = CliRunner().invoke(app, ["bridge", *arguments, "--fleet", str(file)])
        assert done.exit_code == 2
        assert problem in " ".join(done.output.split())


def test_a_robot_that_is_absent_at_the_start_is_named_and_becomes_a_node_when_it_comes(
    peer: Ros2Peer, tmp_path: Path
) -> None:
    sim = {"plugins": {"sim": {"model": "roomba"}}}
    robots = {"far-1": {**sim, "address": f"tcp/127.0.0.1:{free_port()}"}, "near-1": sim}
    file = tmp_path / "absent.yaml"
    file.write_text(json.dumps({"version": 1, "name": "absent", "robots": robots}))
    poses: list[Any] = []
    with Fleet.load(file) as fleet, log_lines() as lines:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint})
        with bridge.open_bridge(fleet, settings) as line:
            assert line.startswith("1 nodes, ")
            peer.subscriber("/far_1/odom", "nav_msgs/msg/Odometry", poses.append)
            commands = peer.publisher("/far_1/cmd_vel", "geometry_msgs/msg/Twist")
            vector = peer.type("geometry_msgs/msg/Vector3")
            ahead, still = vector(x=0.2, y=0.0, z=0.0), vector(x=0.0, y=0.0, z=0.0)

            def moves() -> bool:
                commands.publish(linear=ahead, angular=still)
                return fleet["far-1"]["Base"].get_status().get() == 1

            with RobotService(EALConfigManager.load(file).fleet, "far-1"):
                wait_for(lambda: bool(poses), "it has no topics")
                wait_for(moves, "it does not move")
            told = [line for line in lines.getvalue().splitlines() if "these robots are" in line]
            assert len(told) == 1
            assert "absent" in told[0]
            assert "far-1" in told[0]
