"""`cmd_vel` and leases, and a sustained flood: what a ROS 2 node must not do to a robot that others hold."""

from __future__ import annotations

import json
import statistics
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.managers.plugins import EALPluginManager
from tests.unit.plugins.ros2.rig import Ros2Peer, wait_for
from tests.unit.plugins.served_robot import served_robot

FLOOD_S = 5.0
RATE_HZ = 10_000

pytestmark = pytest.mark.slow


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Path]:
    """The file of a simulated robot that this process serves."""
    with served_robot(tmp_path, "r1") as file:
        yield file


def test_a_robot_that_another_controller_holds_does_not_follow_cmd_vel(peer: Ros2Peer, served: Path) -> None:
    with Fleet.load(served) as holder, Fleet.load(served) as bridged:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint})
        with bridge.open_bridge(bridged, settings):
            vector = peer.type("geometry_msgs/msg/Vector3")
            commands = peer.publisher("/r1/cmd_vel", "geometry_msgs/msg/Twist")

            def send(speed: float) -> bool:
                commands.publish(linear=vector(x=speed, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))
                return False

            def pose() -> list[float]:
                found: list[float] = holder["r1"]["TruePose"].get_value().get().value.tolist()
                return found

            begin = pose()
            turn = holder["r1"]["Base"].send_cmd("l180")  # the holder's motion, under its lease
            wait_for(lambda: send(0.2) or turn.done(), "the holder's motion does not end")
            assert turn.get() == 1  # so cmd_vel has not replaced it
            end = pose()
            assert abs(end[0] - begin[0]) < 0.02
            assert abs(end[1] - begin[1]) < 0.02
            holder["r1"].release("Base")
            wait_for(lambda: send(0.2) or abs(pose()[0] - end[0]) > 0.05, "it does not follow after the release")


def test_refused_velocities_that_cease_do_not_halt_the_holder(peer: Ros2Peer, served: Path) -> None:
    with Fleet.load(served) as holder, Fleet.load(served) as bridged:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint})
        with bridge.open_bridge(bridged, settings):
            vector = peer.type("geometry_msgs/msg/Vector3")
            commands = peer.publisher("/r1/cmd_vel", "geometry_msgs/msg/Twist")
            turn = holder["r1"]["Base"].send_cmd("l720")
            wait_for(lambda: holder["r1"]["Base"].get_status().get() == 1, "the holder's motion does not begin")
            for _ in range(10):
                commands.publish(linear=vector(x=0.2, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))
                holder.clock.sleep(0.05)
            assert turn.get() == 1  # it goes on for seconds after the last velocity


def flood(send: Callable[[], None], over: threading.Event) -> int:
    """Publish velocities at the rate, as far as this machine can; return how many."""
    begin_s, sent = REAL_TIME.now(), 0
    while not over.is_set():
        due = int((REAL_TIME.now() - begin_s) * RATE_HZ)
        while sent < due:
            send()
            sent += 1
    return sent


def test_a_sustained_flood_delays_no_other_robot_and_ends(peer: Ros2Peer, tmp_path: Path) -> None:
    robots = {f"r{n}": {"plugins": {"sim": {"model": "roomba", "start": {"x_m": n, "y_m": 0}}}} for n in (1, 2)}
    path = tmp_path / "fleet.yaml"
    path.write_text(json.dumps({"version": 1, "name": "two", "robots": robots}))
    with Fleet.load(path) as fleet:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint})
        with bridge.open_bridge(fleet, settings):
            vector = peer.type("geometry_msgs/msg/Vector3")
            commands = peer.publisher("/r1/cmd_vel", "geometry_msgs/msg/Twist")

            def send() -> None:
                commands.publish(linear=vector(x=0.1, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=0.0))

            base = fleet["r1"]["Base"]
            wait_for(lambda: (send(), base.get_status().get())[1] == 1, "it does not move")  # type: ignore[func-returns-value]
            before, over, counts = psutil.Process().memory_info().rss, threading.Event(), list[int]()
            thread = threading.Thread(target=lambda: counts.append(flood(send, over)))
            thread.start()
            begin_s, waits = REAL_TIME.now(), []
            while REAL_TIME.now() < begin_s + FLOOD_S:
                asked_s = REAL_TIME.now()
                fleet["r2"]["Pose"].get_value().get()
                waits.append(REAL_TIME.now() - asked_s)
                fleet.clock.sleep(0.01)
            over.set()
            thread.join()
            wait_for(lambda: base.get_status().get() == 0, "it does not halt after the flood")
            grown_mb = (psutil.Process().memory_info().rss - before) / 1e6
            rate, median_ms = counts[0] / FLOOD_S, 1000 * statistics.median(waits)
            about = f"{rate:.0f} a second, median {median_ms:.1f} ms, {grown_mb:.0f} MB"
            print(about)  # noqa: T201  # `-rP` shows it
            assert len(waits) > 20
            assert grown_mb < 100
