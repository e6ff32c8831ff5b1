"""plugins/mote_roomba: the whole plugin in a fleet, over real wires, and as every plugin must be."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from eal_actors.bundled import bundled_path
from eal_actors.clock import ManualClock
from eal_actors.conformance import CHECKS, Bench, Check, run_check, settings_of
from eal_actors.errors import ConfigError, PluginError
from eal_actors.plugin import FleetServices, PluginContext
from plugins.mote_roomba import plugin
from plugins.mote_roomba.protocol import Mode
from tests.unit.mote_roomba.rig import HurriedClock
from tests.unit.mote_roomba.wires import roomba_on_a_pty, roombas_on_sockets

FOLDER = bundled_path("plugins/mote_roomba")


def context_of(port: str) -> PluginContext:
    settings = plugin.Settings.model_validate({"port": port})
    return PluginContext("rob", "mote_roomba", settings, FleetServices(ManualClock()))


def test_a_fleet_drives_it_over_a_pty() -> None:
    with (
        roomba_on_a_pty() as (path, emulator),
        Bench(FOLDER, settings_of({"port": path, "poll_hz": 5, "mode": "full"})).robot() as robot,
    ):
        modes = [emulator.mode]
        assert robot["Battery"].get_value().get().value == 0.5
        assert robot["Base"].send_cmd("f0.05").get() == 1
        assert robot["Base"].send_cmd("l10").get() == 1
        left_m, right_m = robot["Odometry"].send_req("travel").get().value
        assert (left_m + right_m) / 2 == pytest.approx(0.05, abs=0.02)  # real time has its hiccups
        assert (right_m - left_m) / 0.258 == pytest.approx(0.1745, abs=0.1)
        robot["Leds"].send_cmd("status", "green").get()
        drive = robot["Base"].send_cmd("f5")
        robot["Base"].halt().get()
        assert drive.exception() is not None
    assert [*modes, emulator.mode] == [Mode.FULL, Mode.PASSIVE]
    assert emulator.lights.status.name == "GREEN"


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with roombas_on_sockets() as url:
        yield url


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.name)
def test_it_conforms(url: str, check: Check) -> None:
    result = run_check(check, Bench(FOLDER, settings_of({"port": url, "poll_hz": 5})))
    assert result.outcome == "ok", "\n".join([check.description, *result.problems])


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("/no/such/port", "robot 'rob': cannot open the serial port /no/such/port: "),
        ("nonsense://x", "cannot open the serial port nonsense://x: invalid URL"),
        ("socket://127.0.0.1:1", "cannot open the serial port socket://127.0.0.1:1: "),
    ],
)
def test_a_port_that_cannot_be_opened_is_named(port: str, words: str) -> None:
    with pytest.raises(PluginError, match=words):
        plugin.connect(context_of(port))


def test_a_port_on_which_no_roomba_answers_is_named_and_closed() -> None:
    context = replace(context_of("loop://"), services=FleetServices(HurriedClock()))
    with pytest.raises(PluginError, match="robot 'rob': nothing answers on loop://"):
        plugin.connect(context)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"port": "loop://", "baudrate": 9600},
        {"port": "loop://", "mode": "passive"},
        {"port": "loop://", "poll_hz": 0},
        {"port": "loop://", "link": "pigeon"},
        {"port": "loop://", "speed": 1},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ConfigError), Bench(FOLDER, settings_of(settings)).robot():
        pass
