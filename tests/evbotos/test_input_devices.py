"""Gamepads and keyboards of the kernel's uinput drive robots, in QEMU under a kernel that has it."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from evbotos.hosttools import find_tool
from tests.evbotos.guest import Guest

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]

ROOT = Path(__file__).parents[2]
TESTS = "tests/operate/hands/test_input_devices.py"


def test_input_devices_drive_robots(tmp_path: Path) -> None:
    needed = "apt-get", "apt-cache", "dpkg-deb", "readelf", "qemu-system-x86_64"
    missing = [name for name in needed if find_tool(name) is None]
    missing += ["evdev (pip install 'eal-actors[gamepad]')"] * (importlib.util.find_spec("evdev") is None)
    if missing:
        pytest.skip(f"not installed: {', '.join(missing)}")
    options = ["-q", "-n", "0", "-p", "no:cacheprovider", "--color=no", "--timeout=1800"]
    command = [sys.executable, "-B", "-m", "pytest", *options, TESTS]
    outcome = Guest(tmp_path, "uinput", "evdev").run(command, ROOT, 3000.0)
    assert outcome.exit_code == 0, outcome.output
    assert "3 passed" in outcome.output
