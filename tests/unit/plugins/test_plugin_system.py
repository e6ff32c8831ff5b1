"""The system plugin: what it tells of this machine, against what the machine says itself."""

from __future__ import annotations

import json
import os
import shutil
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import pytest

from eal_actors.actors.handles import RobotHandle
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, NotReadyError
from eal_actors.managers.config import EALConfigManager
from plugins.system.gauges import Cpu, Network, Temperature
from tests.robots import WAIT_S


@contextmanager
def watched(**settings: Any) -> Iterator[RobotHandle]:
    content = {"version": 1, "name": "f", "robots": {"r": {"plugins": {"system": settings}, "timeout_s": WAIT_S}}}
    with Fleet(EALConfigManager.of(content, name="test").fleet) as fleet:
        yield fleet["r"]


def test_memory_is_what_the_kernel_says() -> None:
    lines = Path("/proc/meminfo").read_text().splitlines()
    total = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("MemTotal"))
    with watched() as robot:
        assert robot["Memory"].send_req("total").get().value == total
        available = robot["Memory"].send_req("available").get().value
        assert 0 < available <= total
        assert robot["Memory"].get_value().get().value == pytest.approx(1 - available / total, abs=0.2)


def test_the_disk_is_that_of_the_path_and_not_ready_without_it(tmp_path: Path) -> None:
    card = tmp_path / "card"
    with watched(disk=str(card)) as robot:
        with pytest.raises(NotReadyError, match=f"{card} is not there: nothing is mounted"):
            robot["Disk"].get_value().get()
        card.mkdir()
        assert robot["Disk"].send_req("total").get().value == shutil.disk_usage(card).total
        assert 0 <= robot["Disk"].get_value().get().value <= 1


def test_load_and_cores_are_those_of_the_machine() -> None:
    with watched() as robot:
        assert robot["Cpu"].send_req("cores").get().value == os.cpu_count()
        assert len(robot["Cpu"].send_req("load").get().value) == 3
        assert 0 <= robot["Cpu"].get_value().get().value <= 1


def test_the_cpu_s_share_is_over_the_period() -> None:
    cpu = Cpu(0.5)
    cpu.open()
    polling = cpu.background()
    assert next(polling) == 0.5
    sum(number * number for number in range(2_000_000))
    next(polling)
    assert 0 < cpu.get_value() <= 1


def test_uptime_is_what_the_kernel_says() -> None:
    with watched() as robot:
        uptime_s = robot["Uptime"].get_value().get().value
    assert uptime_s == pytest.approx(float(Path("/proc/uptime").read_text().split()[0]), abs=5)


def test_the_network_is_counted_per_second() -> None:
    class Stopwatch:
        now_s = 0.0

        def now(self) -> float:
            return self.now_s

    watch: Any = Stopwatch()
    network = Network("lo", watch, 1.0)
    network.open()
    polling = network.background()
    assert next(polling) == 1.0
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as client:
        peer, _ = server.accept()
        with peer:
            client.sendall(bytes(500_000))
            received = 0
            while received < 500_000:
                received += len(peer.recv(65536))
    watch.now_s = 2.0
    next(polling)
    received_b_s, sent_b_s = network.get_value()
    assert received_b_s >= 250_000
    assert sent_b_s >= 250_000
    assert network.sent() >= 500_000
    assert network.not_ready() is None


def test_an_absent_interface_is_not_ready_and_names_those_there_are() -> None:
    with watched(interface="wlan77") as robot:
        with pytest.raises(NotReadyError, match=r"no network interface 'wlan77' now; there are: .*lo"):
            robot["Network"].get_value().get()
        assert set(robot.not_ready) - {"Temperature"} == {"Network"}
    with watched(interface="lo", resources=["Network"]) as robot:
        assert "127.0.0.1" in json.loads(robot["Network"].send_req("addresses").get().value)["lo"]


def test_a_computer_without_sensors_says_so() -> None:
    readings = [float(reading.current) for chip in psutil.sensors_temperatures().values() for reading in chip]
    with watched() as robot:
        assert ("Temperature" in robot) is bool(readings)
    with watched(resources=["Temperature"]) as robot:
        if readings:
            assert robot["Temperature"].get_value().get().value == pytest.approx(max(readings), abs=20)
        else:
            with pytest.raises(NotReadyError, match="shows no temperature: its operating system knows of no sensor"):
                robot["Temperature"].get_value().get()


@dataclass
class Reading:
    """The used fields of a psutil sensor."""

    label: str
    current: float


def test_the_hottest_part_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    parts = {"cpu": [Reading("core", 61.5), Reading("", 58.0)], "disk": [Reading("", 40.0)]}
    monkeypatch.setattr(psutil, "sensors_temperatures", lambda: parts, raising=False)
    temperature = Temperature(1.0)
    assert temperature.not_ready() is not None
    temperature.open()
    assert temperature.not_ready() is None
    assert temperature.get_value() == 61.5
    assert json.loads(temperature.parts()) == {"cpu core": 61.5, "cpu 1": 58.0, "disk 0": 40.0}


def test_resources_can_be_left_out_and_unknown_ones_are_wrong() -> None:
    with watched(resources=["Uptime", "Memory"]) as robot:
        assert sorted(robot) == ["Memory", "Uptime"]
    with pytest.raises(ConfigError, match="resources"), watched(resources=["Sound"]):
        pass
