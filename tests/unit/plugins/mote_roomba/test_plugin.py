"""plugins/mote_roomba: the whole plugin in a fleet, over real wires, and as every plugin must be."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import ConfigError, PluginError
from eal_actors.plugin import FleetServices, PluginContext
from eal_actors.testing.conformance import Bench, settings_of
from eal_actors.testing.conformance.wires import TcpWire
from plugins.mote_roomba import emulator, plugin
from plugins.mote_roomba.protocol import Mode
from tests.manual_clock import ManualClock
from tests.unit.plugins.mote_roomba.rig import HurriedClock
from tests.unit.plugins.mote_roomba.wires import roomba_on_a_pty, roombas_on_sockets

FOLDER = bundled_path("plugins/mote_roomba")


def context_of(port: str, link: str = "serial") -> PluginContext:
    settings = plugin.Settings.model_validate({"port": port, "link": link})
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


def test_a_fleet_drives_it_over_a_socket() -> None:
    with roombas_on_sockets() as url, Bench(FOLDER, settings_of({"port": url, "poll_hz": 5})).robot() as robot:
        assert robot["Base"].send_cmd("f0.02").get() == 1


def test_a_fleet_drives_motes_over_a_socket() -> None:
    wire = TcpWire(lambda: emulator.emulate({"link": "mote"}, REAL_TIME.now))
    wire.plug_in()
    settings = settings_of({"port": f"socket://{wire.address}", "link": "mote", "poll_hz": 5})
    try:
        with Bench(FOLDER, settings).robot() as robot:
            assert robot["Base"].send_cmd("f0.02").get() == 1
    finally:
        wire.close()


@pytest.mark.parametrize(
    ("port", "words"),
    [
        ("/no/such/port", "cannot open /no/such/port: no such file or directory; next try in "),
        ("socket://127.0.0.1:1", "cannot open socket://127.0.0.1:1: connection refused; next try in "),
        ("loop://", "nothing answers on loop://"),
    ],
)
@pytest.mark.parametrize("link", ["serial", "mote"])
def test_a_roomba_that_is_absent_or_silent_is_not_ready(port: str, words: str, link: str) -> None:
    context = replace(context_of(port, link), services=FleetServices(HurriedClock()))
    connected = plugin.connect(context)
    reason = plugin.create_Bump(replace(context, plugin=connected)).not_ready()
    assert reason is not None
    assert reason.partition(" (the mote ")[0].startswith(words)
    base = plugin.create_Base(replace(context, plugin=connected))
    base.halt()  # nothing moves, so there is nothing to complain of
    base.close()
    plugin.disconnect(connected)


def test_a_port_that_can_never_be_opened_is_refused() -> None:
    with pytest.raises(PluginError, match="serial port nonsense://x: invalid URL"):
        plugin.connect(context_of("nonsense://x"))


def test_settings_for_motes_want_motes() -> None:
    settings = plugin.Settings.model_validate({"port": "loop://", "mote": {"am_type": 6}})
    with pytest.raises(PluginError, match="robot 'rob': the settings under mote are of no use without link: mote"):
        plugin.connect(replace(context_of("loop://"), settings=settings))


@pytest.mark.parametrize(
    "settings",
    [
        {"port": ""},
        {"port": "loop://", "baudrate": 9600},
        {"port": "loop://", "mode": "passive"},
        {"port": "loop://", "poll_hz": 0},
        {"port": "loop://", "link": "pigeon"},
        {"port": "loop://", "speed": 1},
        {"port": "loop://", "link": "mote", "mote": {"header": "tinyos3"}},
        {"port": "loop://", "link": "mote", "mote": {"payload_bytes": 0}},
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ConfigError), Bench(FOLDER, settings_of(settings)).robot():
        pass
