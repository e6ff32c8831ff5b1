"""Robots stop at every end of a program."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from eal_actors import Fleet
from tests.plugin_files import write_plugin

NOTED_PLUGIN = """
from eal_actors.plugin import *
class Base(Resource):
    "A base."
    types = ResourceType.ACTUATOR
    def halt(self): print("halted", flush=True)
    @command("go")
    def go(self):
        print("going", flush=True)
        yield 1000.0
def connect(): return EALPlugin("Base")
def disconnect(plugin): print("disconnected", flush=True)
def create_Base(): return Base()
def destroy_Base(resource): pass
"""


@pytest.fixture
def noted_fleet(tmp_path: Path) -> Path:
    """A fleet whose robot prints what happens to it."""
    write_plugin(tmp_path, "noted", NOTED_PLUGIN, "Base")
    fleet = tmp_path / "fleet.yaml"
    fleet.write_text("version: 1\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {noted: {}}}}\n")
    return fleet


def test_a_fleet_that_a_program_forgot_is_closed_at_its_end(noted_fleet: Path) -> None:
    program = (
        "import eal_actors\n"
        f"base = eal_actors.Fleet.load({str(noted_fleet)!r}).connect()['one']['Base']\n"
        "base.send_cmd('go')\n"
        "base.get_value().exception()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.stdout.split() == ["going", "halted", "disconnected"], done.stderr


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGTSTP])
def test_a_script_that_is_ended_by_a_signal_halts_its_robots(noted_fleet: Path, number: signal.Signals) -> None:
    program = (
        "import eal_actors\n"
        f"with eal_actors.connect(fleet={str(noted_fleet)!r}) as eal:\n"
        "    eal.send_cmd(eal.find_resource('Base'), 'go', timeout_s=1000.0)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "going\n"
        process.send_signal(number)
        out, _ = process.communicate(timeout=60)
    assert out.split()[-1] == "disconnected"
    assert "halted" in out
    assert process.returncode in (-signal.SIGINT, 128 + number)


def test_handlers_of_the_programs_own_are_left_alone(noted_fleet: Path) -> None:
    def mine(*_: object) -> None: ...

    before = signal.signal(signal.SIGHUP, mine)
    try:
        with Fleet.load(noted_fleet):
            assert signal.getsignal(signal.SIGHUP) is mine
            assert signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    finally:
        signal.signal(signal.SIGHUP, before)
