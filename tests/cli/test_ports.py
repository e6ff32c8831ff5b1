"""`eal ports`, and what `eal` says of ports that are taken, forbidden or named twice."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from eal_actors.device.serial_ports import list_serial_ports, open_serial
from tests.unit.device.port_rig import Cable, cable
from tests.unit.device.test_serial_ports import STRANGER, plugged

__all__ = ["cable", "plugged"]

FLEET = """\
version: 1
name: lines
robots:
  one: {plugins: {serial_port: {port: PORT}}}
"""


def test_the_ports_of_this_machine_are_listed(eal: Any) -> None:
    result = eal("ports", "--json")
    assert result.exit_code == 0
    assert [port["path"] for port in json.loads(result.stdout)["ports"]] == [
        str(port.path) for port in list_serial_ports()
    ]
    text = eal("ports")
    assert text.exit_code == 0
    assert "held by" in text.stdout or "This machine has no serial port." in text.stderr


def test_a_port_that_another_program_holds_is_named_with_that_program(eal: Any, plugged: Cable, write: Any) -> None:
    fleet = write("fleet.yaml", FLEET.replace("PORT", str(plugged.path)))
    with closing(open_serial(str(plugged.path), baudrate=9600)):
        result = eal("call", "one", "SerialPort", "get_status", "--fleet", fleet)
    assert result.exit_code == 3
    assert f"(pid {os.getpid()}) has it open" in result.stderr
    assert "Stop that program; `eal ports` lists the serial ports" in result.stderr
    assert "switched on" not in result.stderr


def test_of_several_programs_that_hold_a_port_each_is_named(eal: Any, plugged: Cable, write: Any) -> None:
    fleet = write("fleet.yaml", FLEET.replace("PORT", str(plugged.path)))
    with closing(open_serial(str(plugged.path), baudrate=9600)) as port:
        other = subprocess.Popen(["sleep", "60"], stdin=port.fileno())  # type: ignore[attr-defined]  # a serial port has one
        try:
            result = eal("call", "one", "SerialPort", "get_status", "--fleet", fleet)
        finally:
            other.kill()
            other.wait()
    assert f"(pid {os.getpid()})" in result.stderr  # in the order of their numbers, which begin anew
    assert f"(pid {other.pid})" in result.stderr
    assert ") have it open" in result.stderr
    assert "Stop those programs; `eal ports` lists the serial ports" in result.stderr


def test_a_forbidden_port_is_no_matter_of_its_switch(plugged: Cable, write: Any) -> None:
    fleet: Path = write("fleet.yaml", FLEET.replace("PORT", str(plugged.path)))
    plugged.path.chmod(0o060)
    arguments = ["call", "one", "SerialPort", "get_status", "--fleet", str(fleet)]
    program = f"{STRANGER}\nfrom eal_actors.__main__ import main\nsys.argv[1:] = {arguments}\nmain()\n"
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PATH": ""}
    result = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 3, result.stderr
    assert "permission denied; the group " in result.stderr
    assert "`sudo usermod -aG " in result.stderr
    assert "switched on" not in result.stderr


def test_no_terminal_is_refused_at_once(eal: Any, write: Any) -> None:
    fleet = write("fleet.yaml", FLEET.replace("PORT", "/dev/null"))
    result = eal("call", "one", "SerialPort", "get_status", "--fleet", fleet)
    assert result.exit_code == 3
    assert "/dev/null is no serial port, but another device" in result.stderr
    assert "next try" not in result.stderr


SHARED = """\
version: 1
name: lines
robots:
  one: {plugins: {serial_port: {port: ONE}}}
  two: {ADDRESS plugins: {evbot2: {port: TWO}}}
"""


def shared(one: str, two: str, address: str = "") -> str:
    return SHARED.replace("ONE", one).replace("TWO", two).replace("ADDRESS", address)


@pytest.mark.parametrize("tool", ["check", "doctor"])
def test_two_robots_on_one_port_are_told(eal: Any, write: Any, tmp_path: Path, tool: str) -> None:
    (tmp_path / "by-id").symlink_to("/dev/ttyUSB7")
    fleet = write("fleet.yaml", shared("/dev/ttyUSB7", str(tmp_path / "by-id")))
    result = eal("check", fleet) if tool == "check" else eal("doctor", "--fleet", fleet, "--json")
    assert result.exit_code in (1, 2)
    said = " ".join((result.stdout + result.stderr).split())
    assert "fleet.yaml:5:" in said
    words = "robots.two.plugins.evbot2.port: /dev/ttyUSB7 is used by one (serial_port) already: one robot a port"
    assert words.replace(" ", "") in said.replace(" ", "")


@pytest.mark.parametrize(
    ("one", "two", "address", "is_fine"),
    [
        ("/dev/ttyUSB1", "/dev/ttyUSB2", "", True),
        ("/dev/ttyUSB1", "/dev/ttyUSB1", "address: tcp/10.0.0.5:5000,", True),  # a port of another machine
        ("/dev/ttyUSB1", "/dev/ttyUSB1", "address: tcp/127.0.0.1:5000,", False),
        ("'socket://ser2net:4000'", "'socket://ser2net:4000'", "", False),
        ("'socket://ser2net:4000'", "'socket://ser2net:4001'", "", True),
    ],
)
def test_only_ports_of_one_machine_clash(eal: Any, write: Any, one: str, two: str, address: str, is_fine: bool) -> None:
    result = eal("check", write("fleet.yaml", shared(one, two, address)))
    assert (result.exit_code == 0) is is_fine, result.stdout + result.stderr
