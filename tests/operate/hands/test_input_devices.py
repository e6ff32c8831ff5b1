"""Real input devices, which the kernel's uinput makes: `tests/evbotos/test_input_devices.py` runs this in QEMU."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import EALError
from eal_actors.operate.hands import HandDriver, HandSettings, find_input
from tests.operate.dashboard.rig import counting_fleet, resource_of, wait_for
from tests.operate.hands.test_sticks import ABS_Y, BTN_TR, EV_ABS, EV_KEY
from tests.plugin_files import write_plugin
from tests.unit.plugins.ros2.rig import wait_for as wait_until

pytestmark = pytest.mark.skipif(not os.access("/dev/uinput", os.W_OK), reason="/dev/uinput is not writable here")

BTN_SOUTH, KEY_W, KEY_A, KEY_SPACE = 0x130, 17, 30, 57
TOLD_PLUGIN = """\
import os

from eal_actors.plugin import DataType, EALPlugin, Resource, ResourceType, ValueInfo


class Base(Resource):
    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.DOUBLE, shape=(2,), description="a twist")

    def _tell(self, ahead, left):
        with open(os.environ["TWISTS"], "a") as file:
            file.write(f"{ahead:.2f} {left:.2f}\\n")

    def halt(self):
        self._tell(0.0, 0.0)

    def set_value(self, data):
        self._tell(*data.value)
"""


@contextmanager
def gamepad() -> Iterator[Any]:
    """Plug in a gamepad with a stick from 0 to 255."""
    import evdev

    stick = evdev.AbsInfo(value=128, min=0, max=255, fuzz=0, flat=0, resolution=0)
    abilities: dict[int, Any] = {EV_KEY: [BTN_SOUTH, BTN_TR], EV_ABS: [(0, stick), (1, stick)]}
    with evdev.UInput(abilities, name="EAL gamepad") as device:
        yield device


@contextmanager
def keyboard() -> Iterator[Any]:
    import evdev

    with evdev.UInput({EV_KEY: [KEY_W, KEY_A, KEY_SPACE]}, name="EAL keyboard") as device:
        yield device


def send(device: Any, *events: tuple[int, int, int]) -> None:
    for event in events:
        device.write(*event)
    device.syn()


def test_a_gamepad_drives_until_it_is_released_and_until_it_is_unplugged(tmp_path: Path) -> None:
    failed: list[EALError] = []
    with counting_fleet(tmp_path, "one").connect() as fleet:
        base = resource_of(fleet, "one", "Base")
        with gamepad() as device:
            source = find_input(Path(str(device.device.path)))
            assert (source.name, source.ranges[ABS_Y]) == ("EAL gamepad", (0, 255))

            def run() -> None:
                try:
                    HandDriver(fleet, ["one"], HandSettings(silence_s=60.0), lambda _: None).run(source)
                except EALError as error:
                    failed.append(error)

            thread = threading.Thread(target=run)
            thread.start()
            for _ in range(2):
                send(device, (EV_ABS, ABS_Y, 0), (EV_KEY, BTN_TR, 1))
                wait_for(base, lambda: base.twist[0] > 0)
                send(device, (EV_KEY, BTN_TR, 0))
                wait_for(base, lambda: base.twist == [0.0, 0.0])
            send(device, (EV_KEY, BTN_TR, 1))
            wait_for(base, lambda: base.twist[0] > 0)
        thread.join(60)
        source.close()
        wait_for(base, lambda: base.twist == [0.0, 0.0])
    assert ["unplugged" in error.message for error in failed] == [True]


@pytest.mark.parametrize("kind", ["gamepad", "keyboard"])
def test_the_command_finds_the_gamepad_and_takes_a_keyboard_by_its_file(tmp_path: Path, kind: str) -> None:
    write_plugin(tmp_path, "told", TOLD_PLUGIN, "Base")
    fleet, twists = tmp_path / "fleet.yaml", tmp_path / "twists"
    fleet.write_text("version: 1\nname: told\nplugin_dirs: [plugins]\nrobots: {one: {plugins: {told: {}}}}\n")
    twists.touch()

    def last() -> tuple[float, float]:
        lines = twists.read_text().splitlines()
        ahead, left = map(float, lines[-1].split()) if lines else (0.0, 0.0)
        return ahead, left

    presses: dict[str, tuple[Callable[[], Any], list[tuple[int, int, int]], list[tuple[int, int, int]]]] = {
        "gamepad": (gamepad, [(EV_ABS, ABS_Y, 0), (EV_KEY, BTN_TR, 1)], [(EV_KEY, BTN_TR, 0)]),
        "keyboard": (keyboard, [(EV_KEY, KEY_W, 1)], [(EV_KEY, KEY_W, 0)]),
    }
    plug_in, press, release = presses[kind]
    with keyboard(), plug_in() as device:  # a keyboard alone is no gamepad
        path = [] if kind == "gamepad" else ["--device", device.device.path]
        program = subprocess.Popen(
            [sys.executable, "-m", "eal_actors", "drive", "one", "--fleet", fleet, "--silence-s", "60", *path],
            env={**os.environ, "TWISTS": str(twists), "PYTHONPATH": str(bundled_path("."))},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            assert program.stdout is not None
            assert f"EAL {kind}: hold a shoulder button" in program.stdout.readline()
            for _ in range(2):
                send(device, *press)
                wait_until(lambda: last()[0] > 0, "it does not drive")
                send(device, *release)
                wait_until(lambda: last() == (0.0, 0.0), "it does not halt")
            send(device, *press)
            wait_until(lambda: last()[0] > 0, "it does not drive")
            device.close()  # unplugged
            _, said = program.communicate(timeout=120)
        finally:
            program.kill()
            program.wait()
    assert "was unplugged" in said
    assert program.returncode not in (0, -9)
    assert last() == (0.0, 0.0)
