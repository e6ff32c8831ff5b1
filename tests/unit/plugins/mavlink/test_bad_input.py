"""Strangers, other components, floods and absurd numbers: the vehicle drives on, or the robot says why not."""

from __future__ import annotations

import json
import math
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from eal_actors import Fleet
from eal_actors.kernel.clock import REAL_TIME
from tests.log_lines import log_lines
from tests.unit.plugins.mavlink.rig import Vehicle
from tests.unit.plugins.mavlink.test_vehicles import CALL_S, ready, settings_of
from tests.unit.plugins.mqtt.rig import mqtt_fleet
from tests.unit.plugins.ros2.rig import free_port, wait_for

FLOOD_HZ = 10_000


@contextmanager
def flooding(port: int, *datagrams: bytes) -> Iterator[list[int]]:
    """Send datagrams to a UDP port from another address, 10 kHz as far as this machine can; yields the count."""
    end, sent = threading.Event(), [0]

    def run() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            while not end.wait(0.01):
                for _ in range(FLOOD_HZ // 100):
                    stranger.sendto(datagrams[sent[0] % len(datagrams)], ("127.0.0.1", port))
                    sent[0] += 1

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield sent
    finally:
        end.set()
        thread.join()


def packed(system: int, component: int, name: str, *fields: Any) -> bytes:
    codec = mavlink.MAVLink(None, system, component)
    message: bytes = getattr(codec, f"{name}_encode")(*fields).pack(codec)
    return message


@contextmanager
def one_rover(folder: Path) -> Iterator[tuple[Fleet, Vehicle, int]]:
    port = free_port()
    with Vehicle(port) as rover, mqtt_fleet(folder, "mavlink", one=settings_of(port, auto_arm=True)) as fleet:
        ready(fleet, "one")
        yield fleet, rover, port


def test_strangers_at_the_port_do_not_take_the_answers(tmp_path: Path) -> None:
    """Set-points and the heartbeat go to the vehicle, not to the last sender."""
    noise = b"\x00" * 40, packed(77, 1, "local_position_ned", 0, 50.0, 50.0, 0.0, 0.0, 0.0, 0.0)
    with one_rover(tmp_path) as (fleet, rover, port), flooding(port, *noise) as sent:
        assert fleet["one"]["Base"].send_cmd("f0.5", timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.5, 0.0), abs=0.05)
    assert sent[0] > 1000


def test_another_component_of_the_vehicle_is_not_its_autopilot(tmp_path: Path) -> None:
    """A gimbal or a computer on board has the vehicle's system, and heartbeats of its own."""
    with one_rover(tmp_path) as (fleet, rover, _):
        driving = fleet["one"]["Base"].send_cmd("f1", timeout_s=CALL_S)
        while not driving.done():
            rover.say(packed(1, 154, "heartbeat", mavlink.MAV_TYPE_GIMBAL, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4))
            rover.say(packed(1, 191, "local_position_ned", 0, 50.0, 50.0, 0.0, 0.0, 0.0, 0.0))
            REAL_TIME.sleep(0.02)
        assert driving.get() == 1
        assert rover.pose[:2] == pytest.approx((1.0, 0.0), abs=0.05)


@pytest.mark.parametrize("north_m", [3e38, -3e38, 1e9])
def test_an_absurd_position_is_ignored(tmp_path: Path, north_m: float) -> None:
    with one_rover(tmp_path) as (fleet, rover, _):
        for _ in range(20):
            rover.say(packed(1, 1, "local_position_ned", 0, north_m, north_m, 0.0, 0.0, 0.0, 0.0))
        wait_for(lambda: max(map(abs, fleet["one"]["Pose"].get_value().get().value)) < 10.0, "it stays there")
        assert fleet["one"]["Base"].send_cmd("f0.3", timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.3, 0.0), abs=0.05)


def test_texts_of_the_autopilot_do_not_flood_the_log(tmp_path: Path) -> None:
    with log_lines() as lines, one_rover(tmp_path) as (fleet, rover, _):
        for number in range(5000):
            rover.say(packed(1, 1, "statustext", 4, f"text {number}".encode()))
        assert fleet["one"]["Base"].send_cmd("f0.3", timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.3, 0.0), abs=0.05)
    assert 1 <= lines.getvalue().count("the autopilot says") < 100


@pytest.mark.slow
def test_a_flood_of_one_vehicle_leaves_another_unharmed(tmp_path: Path) -> None:
    ports = free_port(), free_port()
    robots = {name: settings_of(port, auto_arm=True) for name, port in zip("ab", ports, strict=True)}
    attitude = packed(1, 1, "attitude", 0, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0)
    with Vehicle(ports[0]), Vehicle(ports[1]) as other, mqtt_fleet(tmp_path, "mavlink", **robots) as fleet:
        ready(fleet, "a")
        ready(fleet, "b")
        with flooding(ports[0], attitude):
            assert fleet["b"]["Base"].send_cmd("f0.3", timeout_s=CALL_S).get() == 1
            assert other.pose[0] == pytest.approx(0.3, abs=0.05)
        ready(fleet, "a")


PROGRAM = """
import sys
from eal_actors import Fleet
with Fleet.load(sys.argv[1]) as fleet:
    for _ in range(100):
        if "Base" not in fleet["one"].not_ready:
            break
        fleet.clock.sleep(0.1)
    print(fleet["one"]["Base"].send_cmd("f3", timeout_s=120).get())
"""


@pytest.mark.slow
def test_a_vehicle_is_not_called_silent_because_the_program_stood_still(tmp_path: Path) -> None:
    """Messages that it sent meanwhile wait at the port, and are read before it is judged."""
    port = free_port()
    robots = {"one": {"plugins": {"mavlink": settings_of(port, auto_arm=True)}}}
    (tmp_path / "fleet.yaml").write_text(json.dumps({"version": 1, "name": "k", "robots": robots}))
    with Vehicle(port) as rover:
        program = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(tmp_path / "fleet.yaml")], stdout=subprocess.PIPE, text=True
        )
        try:
            for stop_m in (0.3, 1.0, 1.7, 2.4):
                wait_for(lambda: rover.pose[0] > stop_m or program.poll() is not None, "it does not move")  # noqa: B023
                program.send_signal(signal.SIGSTOP)
                REAL_TIME.sleep(2.0)
                program.send_signal(signal.SIGCONT)
            said, _ = program.communicate(timeout=120)
        finally:
            program.kill()
            program.wait()
        assert said == "1\n"
        assert rover.pose[0] == pytest.approx(3.0, abs=0.1)
