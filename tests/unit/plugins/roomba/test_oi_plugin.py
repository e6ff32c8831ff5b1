"""plugins/roomba: the whole plugin on wires, what it shares with the older Roomba, and a client of others."""

from __future__ import annotations

import gc
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.plugin import FleetServices, PluginContext
from eal_actors.testing.conformance import Bench, settings_of
from plugins.roomba.plugin import RoombaPlugin
from plugins.sim import plugin as sim
from tests.manual_clock import ManualClock
from tests.unit.plugins.roomba.oi_rig import OiRig

ROOT = Path(__file__).parents[4]
FOLDER = bundled_path("plugins/roomba")
ONE_CONTROLLER = ("Base", "Bump", "Cliff", "Wall", "Battery", "Odometry", "Song")
"""The resources of every Roomba, real or simulated; lights, buttons and drops differ."""


@contextmanager
def emulator_program(*arguments: str, protocol: str = "oi") -> Iterator[tuple[str, list[str]]]:
    """Run an emulator as a program; gives its port, and at the end of the block what it says when it is ended."""
    process = subprocess.Popen(
        [sys.executable, "-m", "plugins.roomba.emulator", "--protocol", protocol, "--pty", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    said: list[str] = []
    with process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip(), said
        finally:
            process.send_signal(signal.SIGINT)
            said += process.stdout.read().splitlines()
    assert process.returncode == 0


def pose_of(said: list[str]) -> tuple[float, float, float]:
    found = re.fullmatch(r"pose (\S+) m (\S+) m (\S+) deg", said[-1])
    assert found is not None
    return float(found[1]), float(found[2]), float(found[3])


@pytest.mark.parametrize(
    ("arguments", "settings"),
    [
        (("--pace",), {"protocol": "oi"}),
        (("--pace",), {"protocol": "sci"}),
        (("--pace", "--mote"), {"protocol": "sci", "link": "mote"}),
    ],
)
def test_a_fleet_drives_the_emulator_that_runs_as_a_program(
    arguments: tuple[str, ...], settings: dict[str, str]
) -> None:
    with emulator_program(*arguments, protocol=settings["protocol"]) as (port, said):
        bench = Bench(FOLDER, settings_of({"port": port, "poll_hz": 5, **settings}))
        with bench.robot() as robot:
            assert robot["Base"].send_cmd("f0.05").get() == 1
            travel = robot["Odometry"].get_value().get().value
            assert robot["Battery"].get_value().get().value == 0.5
    x_m, y_m, yaw_deg = pose_of(said)
    assert (x_m, y_m, yaw_deg) == pytest.approx((0.05, 0.0, 0.0), abs=0.03)  # real time has its hiccups
    assert travel[0] == pytest.approx(x_m, abs=0.01)


def test_pycreate2_drives_the_emulator_and_reads_its_sensors() -> None:
    from pycreate2 import Create2  # type: ignore[import-untyped]

    with emulator_program() as (port, said):
        robot = Create2(port)
        try:
            robot.start()
            robot.safe()
            assert robot.get_sensors().open_interface_mode == 2
            way_m, at_first = 0.0, robot.get_sensors()
            robot.drive_direct(200, 200)
            while way_m < 0.2:
                way_m += robot.get_sensors().distance / 1000  # waits 15 ms for the reply, as a user's program does
            robot.drive_direct(0, 0)
            robot.drive_stop()
            sensors = robot.get_sensors()
            way_m += sensors.distance / 1000
            counted = sensors.encoder_counts_left - at_first.encoder_counts_left
        finally:
            del robot  # it stops, goes dark and closes, in its own good time
            gc.collect()
    x_m, y_m, yaw_deg = pose_of(said)
    assert 0.2 <= x_m < 0.3
    assert (y_m, yaw_deg) == (0.0, 0.0)
    assert way_m == pytest.approx(x_m, abs=0.002)
    assert counted * math.pi * 0.072 / 508.8 == pytest.approx(x_m, abs=0.002)
    assert (sensors.voltage, sensors.current, sensors.temperature) == (16100, -300, 24)
    assert (sensors.battery_charge, sensors.battery_capacity) == (1350, 2700)
    assert (sensors.wall, sensors.cliff_left, sensors.velocity_left) == (False, False, 0)
    assert not any(sensors.bumps_wheeldrops)


def test_pyroombaadapter_drives_the_emulator_and_reads_its_sensors() -> None:
    from pyroombaadapter import PyRoombaAdapter

    with emulator_program() as (port, said):
        robot = PyRoombaAdapter(port)
        try:
            assert robot.request_oi_mode() == 2
            robot.request_distance()
            way_m = 0.0
            robot.send_drive_direct(200, 200)
            while way_m < 0.2:
                way_m += robot.request_distance() / 1000
            robot.send_drive_direct(0, 0)
            way_m += robot.request_distance() / 1000
            voltage_mv, capacity_mah = robot.request_voltage(), robot.request_capacity()
        finally:
            del robot  # it leaves the Roomba in passive mode, and closes
            gc.collect()
    x_m, y_m, yaw_deg = pose_of(said)
    assert x_m >= 0.2
    assert (y_m, yaw_deg) == (0.0, 0.0)
    assert way_m == pytest.approx(x_m, abs=0.05)
    assert (voltage_mv, capacity_mah) == (16100, 2700)


@pytest.mark.parametrize("name", ONE_CONTROLLER)
def test_it_says_of_itself_what_the_simulated_roomba_does(name: str) -> None:
    context = PluginContext(
        "rob", "twin", sim.Settings.model_validate({"model": "roomba"}), FleetServices(ManualClock())
    )
    twin = sim.connect(context).makers[name]()
    real = RoombaPlugin(context, OiRig().roomba).makers[name]()
    real.name = twin.name = name
    assert real.info() == twin.info()
