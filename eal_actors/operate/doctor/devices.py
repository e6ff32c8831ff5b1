"""Devices that plugins name: whether they are there, whether we may use them, and whether cameras are cameras."""

from __future__ import annotations

import fcntl
import getpass
import grp
import os
import stat
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA: Final = "devices"
_CAMERAS: Final = "cameras"
_QUERY_CAPABILITIES: Final = 0x80685600
"""VIDIOC_QUERYCAP of linux/videodev2.h, which fills a `struct v4l2_capability` of 104 bytes."""
_CAPABILITIES: Final = struct.Struct("=16s32s32sIII12x")
_CAPTURES: Final = 0x00000001 | 0x00001000  # V4L2_CAP_VIDEO_CAPTURE, and that of several planes
_HAS_DEVICE_CAPABILITIES: Final = 0x80000000


@dataclass(frozen=True, slots=True)
class NamedDevice:
    """A device that a fleet file names.

    Attributes:
        robot: whose plugin names it.
        path: such as `/dev/ttyUSB0`.
        is_camera: whether pictures are expected of it.
    """

    robot: str
    path: Path
    is_camera: bool


@dataclass(frozen=True, slots=True)
class DeviceFacts:
    """What the system tells of a device's path.

    Attributes:
        exists: whether there is something.
        is_device: whether that is a character device, as serial ports and cameras are.
        usable: whether this process may read and write it.
        group: the group that may use it; empty where its rights give that to no group.
        is_member: whether the user is in that group, by the system's list, whatever this process has inherited.
    """

    exists: bool
    is_device: bool = False
    usable: bool = False
    group: str = ""
    is_member: bool = False


def named_devices(robots: Iterable[RobotConfig]) -> list[NamedDevice]:
    """Return the devices that robots' plugins name, each once a robot: texts below /dev, and numbers of cameras."""
    found: dict[NamedDevice, None] = {}
    for robot in robots:
        for settings in robot.plugins.values():
            number = settings.settings.get("source") if settings.plugin == "camera" else None
            if type(number) is int:
                found[NamedDevice(robot.name, Path(f"/dev/video{number}"), True)] = None
            for text in _texts(settings.settings):
                if text.startswith("/dev/"):
                    found[NamedDevice(robot.name, Path(text), settings.plugin == "camera")] = None
    return list(found)


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for item in value.values():
            yield from _texts(item)
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _texts(item)


def check_devices(devices: Iterable[NamedDevice]) -> Iterator[Diagnostic]:
    """Yield what is to be said of devices of this machine."""
    for device in devices:
        facts = read_facts(device.path)
        yield judge_device(device, facts, _user(), _others_like(device.path))
        if device.is_camera and facts.is_device and facts.usable:
            yield judge_camera(device, _capabilities(device.path))


def read_facts(path: Path) -> DeviceFacts:
    """Return what the system tells of a path."""
    try:
        status = path.stat()
    except OSError:
        return DeviceFacts(exists=False)
    needed = stat.S_IRGRP | stat.S_IWGRP
    group, members = "", []
    if status.st_mode & needed == needed:
        try:
            entry = grp.getgrgid(status.st_gid)
        except KeyError:  # a group of another system
            group = str(status.st_gid)
        else:
            group, members = entry.gr_name, entry.gr_mem
    return DeviceFacts(
        exists=True,
        is_device=stat.S_ISCHR(status.st_mode),
        usable=os.access(path, os.R_OK | os.W_OK),
        group=group,
        is_member=_user() in members,
    )


def judge_device(device: NamedDevice, facts: DeviceFacts, user: str, others: Iterable[str] = ()) -> Diagnostic:
    """Return whether a plugin will be able to open its device.

    Args:
        device: the device.
        facts: what the system tells of it.
        user: who we are.
        others: paths that could be meant where it is not there.
    """
    name = f"{device.path} of {device.robot}"
    if not facts.exists:
        there = ", ".join(others)
        hint = f"There is {there}. " if there else ""
        return problem(_AREA, f"{name} is not there", f"{hint}Switch it on and plug it in, or correct the fleet file.")
    if not facts.is_device:
        return problem(_AREA, f"{name} is not a device", "Name the device itself in the fleet file.")
    if facts.usable:
        return ok(_AREA, f"{name} is there and may be used")
    if not facts.group:
        advice = f"Its rights admit no group: have a udev rule give it to one, such as dialout, and put {user} in it."
    elif facts.is_member:
        advice = f"{user} is in the group {facts.group}, but not in this session: log out and in again."
    else:
        advice = f"sudo usermod -aG {facts.group} {user}; then log out and in again."
    return problem(_AREA, f"{name} may not be used by {user}", advice)


def judge_camera(device: NamedDevice, capabilities: bytes | None) -> Diagnostic:
    """Return whether a device gives pictures.

    Args:
        device: the device.
        capabilities: its `struct v4l2_capability`; None if it has none.
    """
    if capabilities is None:
        return problem(
            _CAMERAS, f"{device.path} of {device.robot} is no camera", "Name another one: v4l2-ctl --list-devices"
        )
    _, card, _, _, whole, own = _CAPABILITIES.unpack(capabilities)
    name = card.partition(b"\0")[0].decode("utf-8", "replace")
    if (own if whole & _HAS_DEVICE_CAPABILITIES else whole) & _CAPTURES:
        return ok(_CAMERAS, f"{device.path} of {device.robot} is {name}")
    return warning(
        _CAMERAS,
        f"{device.path} of {device.robot} belongs to {name}, but gives no pictures",
        "Cameras often have a second device for other data; name the first one: v4l2-ctl --list-devices",
    )


def _capabilities(path: Path) -> bytes | None:
    buffer = bytearray(_CAPABILITIES.size)
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        fcntl.ioctl(descriptor, _QUERY_CAPABILITIES, buffer)
    except OSError:
        return None
    finally:
        os.close(descriptor)
    return bytes(buffer)


def _others_like(path: Path) -> list[str]:
    """Return devices of the same kind: those whose names differ in the number, or all serial ports."""
    stem = path.name.rstrip("0123456789")
    patterns = ("ttyUSB*", "ttyACM*", "ttyAMA*", "serial/by-id/*") if stem.startswith("tty") else (f"{stem}[0-9]*",)
    return [str(found) for pattern in patterns for found in sorted(Path("/dev").glob(pattern))][:4]


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a number without a name, as in some containers
        return str(os.getuid())
