"""Opening serial ports: alone, with its control lines, with reasons that help; and the list of a machine's ports."""

from __future__ import annotations

import fcntl
import os
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest
import serial
import serial.rfc2217

from eal_actors.device.port_holders import PortHolder, holders
from eal_actors.device.serial_ports import list_serial_ports, open_serial
from tests.unit.device.port_rig import WAIT_S, Cable, cable

__all__ = ["cable"]

GET_EXCLUSIVE: Final = 0x80045440
"""TIOCGEXCL of asm-generic/ioctls.h."""

STRANGER: Final = """
import ctypes, os, sys
libc = ctypes.CDLL(None, use_errno=True)
header, none = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
assert libc.capset(header, none) == 0  # root without its capabilities is a user like any other
from eal_actors.device import serial_ports
"""
READ: Final = STRANGER + "os.close(os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY))"
OPEN: Final = (
    STRANGER
    + """
try:
    serial_ports.open_serial(sys.argv[1], baudrate=9600)
except OSError as error:
    print(error.__notes__)
"""
)


def as_a_stranger(program: str, path: Path) -> subprocess.CompletedProcess[str]:
    """Run a program as a user without rights of root."""
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "PATH": ""}
    return subprocess.run(
        [sys.executable, "-c", program, str(path)], env=environment, capture_output=True, text=True, check=False
    )


@pytest.fixture
def plugged(cable: Cable) -> Cable:
    cable.plug_in()
    cable.path.chmod(0o666)
    return cable


def test_a_plain_reader_cannot_open_a_port_that_is_held(plugged: Cable) -> None:
    assert as_a_stranger(READ, plugged.path).returncode == 0
    with closing(open_serial(str(plugged.path), baudrate=9600)) as port:
        assert struct.unpack("i", fcntl.ioctl(port.fileno(), GET_EXCLUSIVE, bytes(4))) == (1,)  # type: ignore[attr-defined]
        refused = as_a_stranger(READ, plugged.path)
        assert "Device or resource busy" in refused.stderr
        assert list(holders(plugged.path))[:1] == [PortHolder(os.getpid(), Path("/proc/self/comm").read_text().strip())]
    assert as_a_stranger(READ, plugged.path).returncode == 0
    with closing(open_serial(str(plugged.path), baudrate=9600, exclusive=False)):
        assert as_a_stranger(READ, plugged.path).returncode == 0


def test_a_forbidden_port_names_the_group_that_may_open_it(plugged: Cable) -> None:
    plugged.path.chmod(0o060)
    words = as_a_stranger(OPEN, plugged.path).stdout
    assert "may open it, and " in words
    assert "has not been in it since login" in words
    plugged.path.chmod(0o000)
    assert "only root may open it; a udev rule can give it to a group" in as_a_stranger(OPEN, plugged.path).stdout


@contextmanager
def serial_server() -> Iterator[tuple[str, Any]]:
    """Serve a loop-back port by RFC 2217, with pyserial's server; gives its URL and the port."""
    with closing(serial.serial_for_url("loop://")) as port, socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(WAIT_S)

        def serve() -> None:
            peer, _ = listener.accept()

            class Sender:
                def write(self, data: bytes) -> None:
                    peer.sendall(data)

            manager = serial.rfc2217.PortManager(port, Sender())
            with peer:
                while data := peer.recv(4096):
                    for byte in manager.filter(data):
                        port.write(byte)

        thread = threading.Thread(target=serve)
        thread.start()
        yield f"rfc2217://127.0.0.1:{listener.getsockname()[1]}", port
        thread.join(WAIT_S)
        assert not thread.is_alive()


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # of pyserial
@pytest.mark.parametrize(("dtr", "rts"), [(True, True), (False, True), (True, False), (False, False)])
def test_the_control_lines_have_the_wanted_levels_at_the_far_end(dtr: bool, rts: bool) -> None:
    with serial_server() as (url, far), closing(open_serial(url, baudrate=9600, dtr=dtr, rts=rts)) as port:
        assert (far.dtr, far.rts) == (dtr, rts)
        port.dtr = not dtr  # type: ignore[attr-defined]
        assert far.dtr is not dtr


@pytest.fixture
def machine(tmp_path: Path, plugged: Cable) -> tuple[Path, Path]:
    """The devices and the kernel's description of a machine with an FTDI adapter, whose port is a real terminal."""
    dev, sysfs = tmp_path / "dev", tmp_path / "sys"
    usb = sysfs / "devices/pci0/usb1/1-2"
    real = usb / "1-2:1.0/ttyUSB0/tty/ttyUSB0"
    for folder in (
        dev / "serial/by-id",
        real,
        sysfs / "class/tty/ttyS0",
        sysfs / "class/tty/ttyS4/device",
        sysfs / "class/tty/tty1",
    ):
        folder.mkdir(parents=True)
    for name, text in (("idVendor", "0403\n"), ("idProduct", "6001\n"), ("product", "FT232R USB UART\n")):
        (usb / name).write_text(text)
    (usb / "1-2:1.0/ttyUSB0/latency_timer").write_text("16\n")
    (real / "device").symlink_to("../..")
    (sysfs / "class/tty/ttyUSB0").symlink_to(real)
    (sysfs / "class/tty/ttyS4/type").write_text("0\n")
    for name in ("ttyS4", "tty1"):
        (dev / name).touch()
    (dev / "ttyUSB0").symlink_to(plugged.path)
    (dev / "serial/by-id/usb-FTDI_A1-if00-port0").symlink_to("../../ttyUSB0")
    return dev, sysfs


def test_ports_are_listed_with_their_lasting_names_usb_ids_and_holders(machine: tuple[Path, Path]) -> None:
    (port,) = list_serial_ports(*machine)  # without consoles, and without ports that no board has
    dev = machine[0]
    assert (port.path, port.names) == (dev / "ttyUSB0", (dev / "serial/by-id/usb-FTDI_A1-if00-port0",))
    assert (port.usb, port.product, port.latency_ms, port.is_usable) == ("0403:6001", "FT232R USB UART", 16, True)
    with closing(open_serial(str(dev / "ttyUSB0"), baudrate=9600)):
        (port,) = list_serial_ports(*machine)
        assert os.getpid() in [holder.pid for holder in port.holders]


def test_a_machine_without_ports_has_an_empty_list(tmp_path: Path) -> None:
    assert list_serial_ports(tmp_path, tmp_path) == []
