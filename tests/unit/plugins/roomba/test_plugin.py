"""plugins/roomba: the whole plugin in a fleet, over real wires, and as every plugin must be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from eal_actors.device.emulator_wires import TcpWire
from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import PluginError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.plugin import FleetServices, PluginContext
from eal_actors.testing.conformance import Bench, settings_of
from plugins.roomba import emulator, plugin
from plugins.roomba.motes import ByteEmulator
from plugins.roomba.sci import Mode
from tests.manual_clock import HurriedClock, ManualClock
from tests.unit.plugins.roomba.wires import roomba_on_a_pty, roombas_on_sockets

FOLDER = bundled_path("plugins/roomba")


SCI, OI = {"protocol": "sci"}, {"protocol": "oi"}
MOTE = {**SCI, "link": "mote"}


def context_of(settings: dict[str, Any]) -> PluginContext:
    return PluginContext("rob", "roomba", plugin.Settings.model_validate(settings), FleetServices(ManualClock()))


def test_a_fleet_drives_it_over_a_pty() -> None:
    with (
        roomba_on_a_pty() as (path, emulator),
        Bench(FOLDER, settings_of({**SCI, "port": path, "poll_hz": 5, "mode": "full"})).robot() as robot,
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
    with roombas_on_sockets() as url, Bench(FOLDER, settings_of({**SCI, "port": url, "poll_hz": 5})).robot() as robot:
        assert robot["Base"].send_cmd("f0.02").get() == 1


def _motes() -> ByteEmulator:
    motes = emulator.emulate(MOTE, REAL_TIME.now)
    assert motes is not None
    return motes


def test_a_fleet_drives_motes_over_a_socket() -> None:
    wire = TcpWire(_motes)
    wire.plug_in()
    settings = settings_of({**MOTE, "port": f"socket://{wire.address}", "poll_hz": 5})
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
@pytest.mark.parametrize("settings", [SCI, MOTE, OI], ids=["sci", "mote", "oi"])
def test_a_roomba_that_is_absent_or_silent_is_not_ready(port: str, words: str, settings: dict[str, str]) -> None:
    context = replace(context_of({**settings, "port": port}), services=FleetServices(HurriedClock()))
    connected = plugin.connect(context)
    reason = connected.makers["Bump"]().not_ready()
    assert reason is not None
    assert reason.partition(" (the mote ")[0].startswith(words)
    base = connected.makers["Base"]()
    base.halt()  # nothing moves, so there is nothing to complain of
    base.close()
    plugin.disconnect(connected)


@pytest.mark.parametrize("settings", [SCI, OI], ids=["sci", "oi"])
def test_a_port_that_can_never_be_opened_is_refused(settings: dict[str, str]) -> None:
    with pytest.raises(PluginError, match="serial port nonsense://x: invalid URL"):
        plugin.connect(context_of({**settings, "port": "nonsense://x"}))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"port": "loop://"}, "protocol: is missing"),
        ({**SCI, "port": ""}, "port: must have at least 1 characters"),
        (SCI, "port is missing; link: cable needs one"),
        ({**SCI, "port": "loop://", "baudrate": 115200}, "baudrate is 57600 or 19200 with protocol: sci, not 115200"),
        ({**OI, "port": "loop://", "baudrate": 57600}, "baudrate is 115200 with protocol: oi, not 57600"),
        ({**OI, "port": "loop://", "baudrate": 19200}, "baudrate is 115200 with protocol: oi, not 19200"),
        ({**SCI, "port": "loop://", "baudrate": 9600}, "baudrate: must be 115200, 57600 or 19200"),
        ({**SCI, "port": "loop://", "mode": "passive"}, "mode: must be"),
        ({**SCI, "port": "loop://", "poll_hz": 0}, "poll_hz: must be at least 5"),
        ({**SCI, "port": "loop://", "link": "pigeon"}, "link: must be"),
        ({**SCI, "port": "loop://", "link": "sim"}, "link: sim needs a simulated port"),
        ({**SCI, "port": "loop://", "speed": 1}, "unknown key 'speed'"),
        ({**SCI, "port": "loop://", "mote": {"am_type": 6}}, "the settings under mote need link: mote"),
        ({**OI, "port": "loop://", "link": "mote"}, "link: mote needs protocol: sci"),
        ({**MOTE, "port": "loop://", "mote": {"header": "tinyos3"}}, "mote.header: must be"),
        ({**MOTE, "port": "loop://", "mote": {"payload_bytes": 0}}, "mote.payload_bytes: must be at least 1"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, object], words: str) -> None:
    config = EALConfigManager.of({"version": 1, "robots": {"rob": {"plugins": {"roomba": settings}}}})
    (problem,), _ = EALPluginManager().check(config.robot("rob"))
    assert words in f"{problem.path.removeprefix('robots.rob.plugins.roomba.')}: {problem.message}"


@pytest.mark.parametrize(("name", "protocol"), [("mote_roomba", "sci"), ("roomba_oi", "oi")])
def test_a_former_name_is_answered_with_the_settings_to_write(name: str, protocol: str) -> None:
    config = EALConfigManager.of({"version": 1, "robots": {"rob": {"plugins": {name: {"port": "/dev/ttyUSB0"}}}}})
    (problem,), _ = EALPluginManager().check(config.robot("rob"))
    assert problem.message.startswith(
        f"the plugin '{name}' is now part of 'roomba': write roomba: {{protocol: {protocol}, ...}} with the other"
    )
