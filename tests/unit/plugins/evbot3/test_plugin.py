"""plugins/evbot3: the whole plugin in a fleet, over real sockets, and what its settings may be."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, NotReadyError
from eal_actors.plugin import UdpPort
from eal_actors.testing.conformance import CHECKS, Bench, Check, run_check, settings_of
from tests.emulated import PATIENT
from tests.unit.plugins.evbot2.test_plugin import wait_until_ready
from tests.unit.plugins.evbot2.wires import evbot3_on

FOLDER = bundled_path("plugins/evbot3")
ROOT = Path(__file__).parents[4]


@pytest.mark.parametrize("scheme", ["udp", "tcp"])
def test_a_fleet_drives_it_over_a_network(scheme: str) -> None:
    with (
        evbot3_on(scheme) as (address, body),
        Bench(FOLDER, settings_of({"address": address, **PATIENT})).robot() as robot,
    ):
        drive, swing = robot["Base"].send_cmd("f0.1"), robot["Turret"].send_cmd("l30")
        assert (drive.get(), swing.get()) == (1, 1)
        assert robot["Turret"].get_value().get().value == pytest.approx(math.radians(30), abs=1e-5)
        assert robot["Odometry"].get_value().get().value == pytest.approx([0.1, 0.0, 0.0], abs=0.004)
        assert robot["Battery"].send_req("voltage").get().value == 12.6
        assert not robot["Bump"].get_value().get().value
        running = robot["Base"].send_cmd("f5")
        robot["Base"].halt().get()
        assert running.exception() is not None
    assert body.pose[0] < 0.3


@pytest.mark.parametrize("scheme", ["udp", "tcp"])
def test_a_base_that_vanishes_and_comes_back(scheme: str) -> None:
    with evbot3_on(scheme) as (address, _):
        port = int(address.rpartition(":")[2])
    bench = Bench(FOLDER, settings_of({"address": address, **PATIENT}))
    with bench.connected([None], ready=False) as (place,):
        base = place.resources["Base"]
        assert isinstance(base.send_cmd("g").exception(), NotReadyError)
        for _ in range(2):
            with evbot3_on(scheme, port):
                wait_until_ready(base)
                assert base.send_cmd("f0.02").get() == 1
                running = base.send_cmd("f5")
            error = running.exception()
            assert error is not None
            assert "127.0.0.1" in str(error)
            while base.get_status().exception() is None:  # until the loss is noticed
                pass
            assert isinstance(place.resources["Turret"].send_cmd("l10").exception(), NotReadyError)


@pytest.mark.parametrize(
    "way", [["--udp", "127.0.0.1:0", "--loss", "0.05", "--reorder", "0.1"], ["--tcp", "127.0.0.1:0"]]
)
def test_the_emulator_is_a_program(way: list[str]) -> None:
    command = [sys.executable, "-m", "plugins.evbot3.emulator", *way, "--seed", "3"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            with Bench(FOLDER, settings_of({"address": address, **PATIENT})).robot() as robot:
                assert robot["Base"].send_cmd("b0.02").get() == 1
                assert robot["Turret"].send_cmd("t45").get() == 1
        finally:
            process.terminate()


ON_ONE_BASE = [check for check in CHECKS if check.name not in ("shares no state", "releases its ports")]
"""The others want two bases, or look at what this process has open, among it the emulator's end."""


@pytest.mark.parametrize("check", ON_ONE_BASE, ids=lambda check: check.name)
def test_it_conforms_over_tcp(check: Check) -> None:
    with evbot3_on("tcp") as (address, _):
        result = run_check(check, Bench(FOLDER, settings_of({"address": address, **PATIENT})))
    assert result.outcome != "failed", "\n".join([check.description, *result.problems])


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1:9000",
        "http://127.0.0.1:9000",
        "udp://127.0.0.1",
        "udp://:9000",
        "udp://127.0.0.1:0",
        "udp://127.0.0.1:70000",
        "udp://127.0.0.1:9000/path",
        "",
    ],
)
def test_addresses_that_make_no_sense_are_refused(address: str) -> None:
    with pytest.raises(ConfigError, match="address"), Bench(FOLDER, settings_of({"address": address})).robot():
        pass


def test_nobody_at_the_other_end_of_a_udp_port_is_silence() -> None:
    with evbot3_on("udp") as (address, _):
        port = int(address.rpartition(":")[2])
    udp = UdpPort("127.0.0.1", port)
    try:
        for _ in range(3):
            assert udp.write(b"hello") == 5
            assert udp.read() == b""
        assert udp.in_waiting in (0, 1)
        udp.reset_input_buffer()
    finally:
        udp.close()
