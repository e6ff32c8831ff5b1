"""Serial ports: opening one for this program alone, and the ports of this machine with those who hold them."""

from __future__ import annotations

import errno
import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from eal_actors.device.port_holders import PortHolder, holders
from eal_actors.device.ports import BytePort, system_error
from eal_actors.device.sockets import open_tcp
from eal_actors.kernel.errors import PluginError
from eal_actors.kernel.posix import TerminalError, grp, user_name

_WRITE_TIMEOUT_S: Final = 1.0
"""Pyserial checks the time after the bytes are sent: on a busy machine a shorter one would lose a working port."""


def open_serial(
    url: str,
    *,
    baudrate: int,
    bytesize: int = 8,
    parity: str = "N",
    stopbits: float = 1,
    exclusive: bool = True,
    dtr: bool = True,
    rts: bool = True,
) -> BytePort:
    """Open a serial port whose reads never wait.

    A USB adapter delivers received bytes at once, instead of up to 16 ms later as FTDI's do at first.

    Args:
        url: a device path, or a URL that pyserial knows, such as `socket://host:port` or `rfc2217://host:port`.
        baudrate: bits a second.
        bytesize: data bits: 5 to 8.
        parity: `N`, `E`, `O`, `M` or `S`.
        stopbits: 1, 1.5 or 2.
        exclusive: keep other programs from opening the device and taking bytes away (`TIOCEXCL` and `flock`). Only a
            program of root can still open it.
        dtr: level of the line DTR, which resets or wakes some boards. Linux raises it for a moment at each opening.
        rts: level of the line RTS; likewise.

    Raises:
        PluginError: the configuration is invalid.
        OSError: it cannot be opened at present; its notes tell who holds the port, or which group may open it.

    Thread: blocks the caller; a connection through a network may take seconds.
    """
    if url.startswith("socket:"):
        return open_tcp(*_host_and_port(url))
    if "://" not in url and (path := Path(url)).exists() and not path.is_char_device():
        raise PluginError(f"{url} is no serial port, but a {'folder' if path.is_dir() else 'file'}")
    from eal_actors.device.tty import new_port  # pyserial, only for serial ports

    line = {"baudrate": baudrate, "bytesize": bytesize, "parity": parity, "stopbits": stopbits, "exclusive": exclusive}
    try:
        port = new_port(url, {**line, "timeout": 0, "write_timeout": _WRITE_TIMEOUT_S})
        port.dtr, port.rts = dtr, rts
        port.open()
    except ValueError as error:
        raise PluginError(f"serial port {url}: {error}") from error
    except (OSError, TerminalError) as error:
        raise _explained(error, url) from error
    opened: BytePort = port
    return opened


def _explained(error: Exception, url: str) -> Exception:
    """Return the error of an opening that failed, with a note on what may help."""
    if isinstance(error, TerminalError):
        return OSError(*error.args)
    found, context = system_error(error), error.__context__
    number = found.errno if found is not None else context.args[0] if isinstance(context, TerminalError) else None
    if number == errno.ENOTTY:
        return PluginError(f"{url} is no serial port, but another device")
    if number in (errno.EBUSY, errno.EAGAIN):
        users = list(map(str, holders(Path(url)))) or ["a program of another user"]
        error.add_note(f"{', '.join(users)} {'has' if len(users) == 1 else 'have'} it open")
    elif number in (errno.EACCES, errno.EPERM):
        group = group_of(Path(url))
        who = f"the group {group} may open it, and {user_name()} has not been in it since login"
        error.add_note(who if group else "only root may open it; a udev rule can give it to a group")
    return error


def _host_and_port(url: str) -> tuple[str, int]:
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError as error:
        raise PluginError(f"serial port {url}: {error}") from error
    if parts.scheme != "socket" or not host or port is None:
        raise PluginError(f"serial port {url}: wanted is socket://host:port")
    return host, port


@dataclass(frozen=True, slots=True)
class SerialPortEntry:
    """A serial port of this machine.

    Attributes:
        path: such as `/dev/ttyUSB0`; the number depends on the order of plugging in.
        names: its paths below `/dev/serial/by-id`, which do not.
        usb: `vendor:product` id of its USB device; None if it is not on USB.
        product: the name that the USB device gives itself; may be empty.
        latency_ms: how long an FTDI adapter holds received bytes back; None for others.
        is_usable: whether this program may read and write it.
        group: the group that may; empty if none may.
        holders: the programs that have it open, as far as this user may see them.
    """

    path: Path
    names: tuple[Path, ...]
    usb: str | None
    product: str
    latency_ms: int | None
    is_usable: bool
    group: str
    holders: tuple[PortHolder, ...]


def list_serial_ports(dev: Path = Path("/dev"), sysfs: Path = Path("/sys")) -> list[SerialPortEntry]:
    """Return the serial ports of this machine, by path. None is opened."""
    names: dict[Path, list[Path]] = {}
    for link in sorted(dev.glob("serial/by-id/*")):
        names.setdefault(link.resolve(), []).append(link)
    found = []
    for entry in sorted((sysfs / "class/tty").glob("*"), key=lambda entry: (len(entry.name), entry.name)):
        path, kind = dev / entry.name, _read(entry / "type")
        if not (entry / "device").exists() or kind == "0" or not path.exists():  # 0: a port that no board has
            continue
        usb, latency = _usb_folder(entry.resolve()), _read(entry / "device/latency_timer")
        found.append(
            SerialPortEntry(
                path=path,
                names=tuple(names.get(path.resolve(), ())),
                usb=_usb_id(usb) if usb else None,
                product=_read(usb / "product") if usb else "",
                latency_ms=int(latency) if latency else None,
                is_usable=os.access(path, os.R_OK | os.W_OK),
                group=group_of(path),
                holders=tuple(holders(path)),
            )
        )
    return found


def usb_id(path: Path, sysfs: Path = Path("/sys")) -> str | None:
    """Return the `vendor:product` id of the USB device behind a path such as `/dev/ttyUSB0`; None without USB."""
    try:
        number = path.stat().st_rdev
        place = (sysfs / "dev/char" / f"{os.major(number)}:{os.minor(number)}").resolve(strict=True)
    except OSError:
        return None
    folder = _usb_folder(place)
    return _usb_id(folder) if folder is not None else None


def _usb_folder(place: Path) -> Path | None:
    """Return the folder of the USB device that a device of the kernel belongs to."""
    return next((folder for folder in place.parents if (folder / "idVendor").is_file()), None)


def _usb_id(folder: Path) -> str:
    return f"{_read(folder / 'idVendor')}:{_read(folder / 'idProduct')}"


def group_of(path: Path) -> str:
    """Return the group that may read and write a device; empty if none may."""
    needed = stat.S_IRGRP | stat.S_IWGRP
    try:
        status = path.stat()
        return grp.getgrgid(status.st_gid).gr_name if status.st_mode & needed == needed else ""
    except KeyError:  # a group of another system
        return str(status.st_gid)
    except OSError:
        return ""


def _read(file: Path) -> str:
    """Return the text of a file of the kernel; empty if there is none."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
