"""Brokers that speak nonsense, fall silent, freeze or flood, and messages at the edge of JSON."""

from __future__ import annotations

import socket
import threading
from pathlib import Path
from typing import Self

import pytest

from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.clock import REAL_TIME
from tests.unit.plugins.mqtt.rig import Broker, Device, error_of, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import wait_for

CONNACK = bytes.fromhex("2003000000")
SUBACK = bytes.fromhex("9004 0001 00 00".replace(" ", ""))
NONSENSE = {
    "no MQTT": b"HTTP/1.1 400 Bad Request\r\n\r\n" * 100,
    "zeros": b"\x00" * 100_000,
    "an endless length": b"\x30\xff\xff\xff\xff\xff\xff",
    "a topic longer than its packet": CONNACK + SUBACK + b"\x30\x04\xff\xff\x00\x00",
    "a topic that is no text": CONNACK + SUBACK + b"\x30\x06\x00\x02\xff\xfe\x00\x00",
    "an empty topic": CONNACK + SUBACK + b"\x30\x03\x00\x00\x00",
    "wrong properties": CONNACK + SUBACK + b"\x30\x09\x00\x02ab\x04\xfe\xff\xff\xff",
    "a packet that it must not send": CONNACK + SUBACK + b"\x10\x00",
    "half a packet": CONNACK + SUBACK + b"\x30\x80\x80\x40",
    "reserved flags": b"\x2f\x03\x00\x00\x00",
}


class Imposter:
    """Listens like a broker, and answers each connection with the same bytes; with None it says nothing, for ever."""

    def __init__(self, port: int, answer: bytes | None) -> None:
        self._answer = answer
        self._listener = socket.create_server(("127.0.0.1", port))
        self._held: list[socket.socket] = []
        self.connections = 0
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()
        for one in self._held:
            one.close()

    def _run(self) -> None:
        while True:
            try:
                one, _ = self._listener.accept()
            except OSError:
                return
            self._held.append(one)
            self.connections += 1
            if self._answer is not None:
                one.settimeout(5.0)
                try:
                    one.recv(4096)
                    one.sendall(self._answer)
                    one.shutdown(socket.SHUT_WR)
                except OSError:
                    continue


TOPICS = {"Say": {"topic": "say", "writable": True}, "Hear": {"topic": "hear"}}


@pytest.mark.slow
@pytest.mark.parametrize("nonsense", [None, *NONSENSE.values()], ids=["silence", *NONSENSE])
def test_a_broker_that_speaks_nonsense_is_named_and_its_successor_taken(tmp_path: Path, nonsense: bytes | None) -> None:
    real = Broker(tmp_path)
    with mqtt_fleet(tmp_path, one={"broker": real.url, "topics": TOPICS}) as fleet:
        with Imposter(real.port, nonsense) as imposter:
            wait_for(lambda: imposter.connections > 0, "it does not connect")
            REAL_TIME.sleep(0.5)
            assert f"cannot reach the MQTT broker at {real.url}: " in why(fleet, "one", "Say", "cannot reach")
            assert "cannot reach" in error_of(lambda: fleet["one"]["Say"].set_value("x").get())
        with real, Device(real) as device:
            until_ready(fleet, "one", "Say")
            device.say("hear", "well")
            wait_for(lambda: not error_of(lambda: fleet["one"]["Hear"].get_value().get()), "nothing is heard")
            assert fleet["one"].state is RobotState.READY


@pytest.mark.slow
def test_a_frozen_broker_is_noticed_and_forgiven(tmp_path: Path) -> None:
    """The keepalive finds it; the robot at another broker answers meanwhile."""
    with Broker(tmp_path) as broker, Broker(tmp_path) as other, mqtt_fleet(
        tmp_path, one={"broker": broker.url, "topics": TOPICS}, two={"broker": other.url, "topics": TOPICS}
    ) as fleet:  # fmt: skip
        until_ready(fleet, "one", "Say")
        until_ready(fleet, "two", "Say")
        broker.freeze()
        try:
            reason = why(fleet, "one", "Say", "cannot reach")
            assert reason.startswith(f"cannot reach the MQTT broker at {broker.url}: the connection was lost: ")
            begin_s = REAL_TIME.now()
            fleet["two"]["Say"].set_value("x").get()
            assert REAL_TIME.now() - begin_s < 5.0
        finally:
            broker.thaw()
        until_ready(fleet, "one", "Say")


@pytest.mark.slow
def test_a_sustained_flood_delays_no_other_robot(broker: Broker, tmp_path: Path) -> None:
    """10 kHz, as far as this machine can, for three seconds."""
    flood = {"Flood": {"topic": "sustained/flood", "value": "number"}}
    quiet = {"Quiet": {"topic": "sustained/quiet", "value": "number"}}
    with Device(broker) as device, Device(broker) as other, mqtt_fleet(
        tmp_path, one={"broker": broker.url, "topics": flood}, two={"broker": broker.url, "topics": quiet}
    ) as fleet:  # fmt: skip
        why(fleet, "one", "Flood", "no message")
        sent = 0
        for turn in range(300):
            for _ in range(100):
                sent += 1
                device.say("sustained/flood", str(sent), qos=0)
            other.say("sustained/quiet", str(turn))
            REAL_TIME.sleep(0.01)
            if turn % 50 == 49:
                begin_s = REAL_TIME.now()
                assert 0 <= fleet["two"]["Quiet"].get_value().get().value <= turn
                assert REAL_TIME.now() - begin_s < 2.0
        device.say("sustained/flood", "-1")  # quality 1: a full queue of the broker may drop the others
        wait_for(lambda: fleet["one"]["Flood"].get_value().get().value == -1, "the newest message is not there")
        wait_for(lambda: fleet["two"]["Quiet"].get_value().get().value == 299, "the other's newest is not there")
