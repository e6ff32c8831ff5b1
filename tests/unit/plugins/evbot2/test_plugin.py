"""plugins/evbot2: the whole plugin in a fleet, over a pseudo-terminal, and what its settings may be."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from eal_actors.actors.handles import ResourceHandle
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, NotReadyError, PluginError
from eal_actors.plugin import FleetServices, PluginContext
from eal_actors.testing.conformance import Bench, settings_of
from plugins.evbot2 import plugin
from tests.emulated import PATIENT
from tests.manual_clock import ManualClock
from tests.unit.plugins.evbot2.wires import evbot2_on_a_pty

FOLDER = bundled_path("plugins/evbot2")
ROOT = Path(__file__).parents[4]


def wait_until_ready(base: ResourceHandle) -> None:
    """Ask until the base answers: each refusal takes a moment in which the driver goes on."""
    for _ in range(100_000):
        if not isinstance(base.get_status().exception(), NotReadyError):
            return
    raise AssertionError("it does not become ready")


def test_a_fleet_drives_it_over_a_pty_at_the_pace_of_a_line() -> None:
    with (
        evbot2_on_a_pty(baud_rate=115200) as (path, body, device),
        Bench(FOLDER, settings_of({"port": path, **PATIENT})).robot() as robot,
    ):
        assert robot["Base"].send_cmd("f0.05").get() == 1
        assert robot["Base"].send_cmd("l10").get() == 1
        x_m, y_m, yaw_rad = robot["Odometry"].get_value().get().value
        assert (x_m, y_m) == pytest.approx((0.05, 0.0), abs=0.003)
        assert yaw_rad == pytest.approx(math.radians(10), abs=0.02)
        drive = robot["Base"].send_cmd("f5")
        robot["Base"].halt().get()
        assert drive.exception() is not None
    assert not device.is_busy
    assert body.pose[0] < 0.2


def test_a_device_that_is_unplugged_and_plugged_in_again(tmp_path: Path) -> None:
    link = tmp_path / "ttyEvBot"
    bench = Bench(FOLDER, settings_of({"port": str(link), **PATIENT}))
    with bench.connected([None], ready=False) as (place,):
        robot = place.resources
        base = robot["Base"]
        error = base.send_cmd("g").exception()
        assert isinstance(error, NotReadyError)
        assert f"cannot open {link}: no such file or directory" in error.message
        for boot in (7, 8):
            with evbot2_on_a_pty(boot) as (path, _, _):
                link.symlink_to(path)
                wait_until_ready(base)
                assert base.send_cmd("f0.02").get() == 1
            link.unlink()
            while base.get_status().exception() is None:  # until the loss is noticed
                pass
        assert robot["Odometry"].get_value().exception() is not None


def test_the_emulator_is_a_program() -> None:
    command = [sys.executable, "-m", "plugins.evbot2.emulator", "--pty", "--pace", "--seed", "3"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            path = process.stdout.readline().strip()
            with Bench(FOLDER, settings_of({"port": path, **PATIENT})).robot() as robot:
                assert robot["Base"].send_cmd("b0.02").get() == 1
        finally:
            process.terminate()


@pytest.mark.parametrize(
    "settings",
    [
        {"port": ""},
        {"port": "loop://", "baudrate": 1200},
        {"port": "loop://", "poll_hz": 51},
        {"port": "loop://", "watchdog_s": 0.05},
        {"port": "loop://", "watchdog_s": 0.1},
        {"port": "loop://", "poll_hz": 5, "watchdog_s": 0.5},
        {"port": "loop://", "calibration": {"track_factor": 3.0}},
        {"port": "loop://", "speed": 1},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ConfigError), Bench(FOLDER, settings_of(settings)).robot():
        pass


@pytest.mark.parametrize(("baudrate", "most_hz"), [(9600, 13), (19200, 26)])
def test_polls_whose_replies_do_not_fit_into_the_line_are_refused(baudrate: int, most_hz: int) -> None:
    settings = {"port": "loop://", "baudrate": baudrate}
    plugin.Settings.model_validate({**settings, "poll_hz": most_hz})
    with pytest.raises(ValueError, match=f"poll_hz must be at most {most_hz} at {baudrate} baud"):
        plugin.Settings.model_validate({**settings, "poll_hz": most_hz + 1})


@pytest.mark.parametrize(
    ("port", "words"),
    [("nonsense://x", "nonsense://x"), ("sim://world/rob", "no simulated ports here"), ("socket://x", "socket://x")],
)
def test_a_port_that_can_never_be_is_refused(port: str, words: str) -> None:
    settings = plugin.Settings.model_validate({"port": port})
    context: Any = PluginContext("rob", "evbot2", settings, FleetServices(ManualClock()))
    with pytest.raises(PluginError, match=words):
        plugin.connect(context)
