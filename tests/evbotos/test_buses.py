"""GPIO, I2C and CAN for plugins: the robot's user reaches them, and others do not.

The lines of GPIO and the CAN bus are the kernel's simulators, the I2C bus is the one of QEMU's PC with its memories.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from evbotos.model import Platform
from evbotos.qemu import Machine
from tests.evbotos.proof import SERVES, Proof, answer, ssh, started, wait_for_words

CHIP = """
mount -t configfs configfs /sys/kernel/config 2>/dev/null
mkdir -p /sys/kernel/config/gpio-sim/board/bank
echo 4 >/sys/kernel/config/gpio-sim/board/bank/num_lines
echo 1 >/sys/kernel/config/gpio-sim/board/live
chip=$(cat /sys/kernel/config/gpio-sim/board/bank/chip_name)
until [ "$(stat -c %G /dev/$chip)" = gpio ]; do sleep 0.1; done
echo $chip
"""
AS_USER = """import os, pwd, sys
user = pwd.getpwnam(sys.argv[1])
os.initgroups(user.pw_name, user.pw_gid)
os.setresgid(*[user.pw_gid] * 3)
os.setresuid(*[user.pw_uid] * 3)
exec(sys.stdin.read())
"""
TURN_ON = """
import gpiod
from gpiod.line import Direction, Value
lines = {0: gpiod.LineSettings(direction=Direction.OUTPUT, output_value=Value.ACTIVE), 1: gpiod.LineSettings()}
with gpiod.request_lines("/dev/CHIP", config=lines) as request:
    print(request.get_value(1).value, open("/sys/devices/platform/gpio-sim.0/CHIP/sim_gpio0/value").read().strip())
"""
WRITE_BYTE = """
import smbus2
with smbus2.SMBus(BUS) as bus:
    bus.write_byte_data(0x50, 3, 0x5a)
    print(bus.read_byte_data(0x50, 3))
"""
SEND_FRAME = """
import socket, struct
with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as one:
    with socket.socket(socket.PF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as other:
        one.bind(("vcan0",)), other.bind(("vcan0",)), other.settimeout(10)
        one.send(struct.pack("=IB3x8s", 0x123, 2, b"ab"))
        number, length, data = struct.unpack("=IB3x8s", other.recv(16))
        print(hex(number), data[:length])
"""
PACKAGES = ("gpiod", "smbus2")
PLACE = "/run/packages"

pytestmark = [pytest.mark.evbotos, pytest.mark.timeout(3600)]


def packed(platform: Platform, folder: Path) -> bytes:
    """Return an archive of the Python packages of the buses, for a platform."""
    tags = [word for tag in platform.wheel_tags for word in ("--platform", tag)]
    options = ["--quiet", "--only-binary=:all:", "--no-deps", "--python-version", "3.11", *tags]
    done = subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, "--target", folder, *PACKAGES], check=False
    )
    if done.returncode:
        pytest.skip(f"{', '.join(PACKAGES)} cannot be had here")
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as file:
        file.add(folder, arcname=".")
    return archive.getvalue()


@pytest.fixture(scope="module")
def machine(proof: Proof, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Proof, Machine]]:
    """A running robot with the Python packages of GPIO and I2C."""
    folder = tmp_path_factory.mktemp("buses")
    archive = packed(proof.platform, folder / "packages")
    disk = Path(shutil.copyfile(proof.built.folder / "disk.img", folder / "disk.img"))
    with started(proof, disk) as machine:
        wait_for_words(machine, SERVES)
        answer(proof, machine, f"mkdir {PLACE} && tar -xf - -C {PLACE}", archive)
        answer(proof, machine, "cat >/run/as_user.py", AS_USER.encode())
        yield proof, machine


def does(machine: tuple[Proof, Machine], program: str, user: str = "robot") -> str:
    """Return what a Python program prints for a user, or the last line of its error."""
    proof, booted = machine
    done = ssh(proof, booted, f"PYTHONPATH={PLACE} python3 /run/as_user.py {user}", program.encode())
    return done.stdout.strip() if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


def test_lines_of_a_gpio_chip(machine: tuple[Proof, Machine]) -> None:
    chip = answer(*machine, CHIP).strip()
    answer(*machine, f"echo pull-up >/sys/devices/platform/gpio-sim.0/{chip}/sim_gpio1/pull")
    assert does(machine, TURN_ON.replace("CHIP", chip)) == "1 1"
    assert "Permission denied" in does(machine, TURN_ON.replace("CHIP", chip), "mdns")


def test_a_memory_on_i2c(machine: tuple[Proof, Machine]) -> None:
    bus = answer(*machine, "grep -l I801 /sys/class/i2c-adapter/i2c-*/name").strip().split("/")[-2].removeprefix("i2c-")
    assert does(machine, WRITE_BYTE.replace("BUS", bus)) == str(0x5A)
    assert "Permission denied" in does(machine, WRITE_BYTE.replace("BUS", bus), "mdns")


def test_a_frame_on_can(machine: tuple[Proof, Machine]) -> None:
    answer(*machine, "ip link add dev vcan0 type vcan && ip link set vcan0 up")
    assert does(machine, SEND_FRAME) == "0x123 b'ab'"
