"""Devices that plugins open: whether they exist, whether this user may open them, and whether cameras capture.

A device is a text below /dev in a plugin's settings. The plugin's manifest declares more about it under `devices`.
"""

from __future__ import annotations

import os
import stat
import struct
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from eal_actors.device.serial_ports import group_of, usb_id
from eal_actors.kernel.posix import fcntl, grp, user_name
from eal_actors.kernel.yaml_tree import texts_in
from eal_actors.managers.fleet_model import PluginSettings, RobotConfig
from eal_actors.managers.manifest import DeviceSection, PluginManifest
from eal_actors.operate.doctor.diagnostic import Diagnostic, ok, problem, warning

_AREA: Final = "devices"
_CAMERAS: Final = "cameras"
_QUERY_CAPABILITIES: Final = 0x80685600
"""VIDIOC_QUERYCAP of linux/videodev2.h, which fills a `struct v4l2_capability` of 104 bytes."""
_CAPABILITIES: Final = struct.Struct("=16s32s32sIII12x")
_CAPTURES: Final = 0x00000001 | 0x00001000  # V4L2_CAP_VIDEO_CAPTURE, and V4L2_CAP_VIDEO_CAPTURE_MPLANE
_HAS_DEVICE_CAPABILITIES: Final = 0x80000000
_SERIAL_PORTS: Final = ("ttyUSB*", "ttyACM*", "ttyAMA*", "serial/by-id/*")
_MOST_OTHERS: Final = 4
_TERMINAL_DRIVERS: Final = Path("/proc/tty/drivers")
"""A line a driver: its name, its devices, their major number (proc(5))."""


@dataclass(frozen=True, slots=True)
class NamedDevice:
    """A device that a fleet file names.

    Attributes:
        path: such as `/dev/ttyUSB0`.
        kind: as its plugin declares it: `serial`, `camera` or `other`.
        usb: USB ids, `vendor:product`, that the plugin declares for it.
        group: the group that usually may open it.
    """

    robot: str
    path: Path
    kind: Literal["serial", "camera", "other"] = "other"
    usb: tuple[str, ...] = ()
    group: str = "dialout"


@dataclass(frozen=True, slots=True)
class DeviceFacts:
    """The system's information on the path of a device.

    Attributes:
        is_device: whether it is a character device, as serial ports and cameras are.
        is_terminal: whether a terminal's driver has it, as every serial port's is; None if the system does not tell.
        usable: whether this process may read and write it.
        group: the group that may read and write it; empty if none may.
        is_member: whether the group database lists the user in that group; this process may not have it yet.
    """

    exists: bool
    is_device: bool = False
    is_terminal: bool | None = None
    usable: bool = False
    group: str = ""
    is_member: bool = False


def named_devices(robots: Iterable[RobotConfig], manifests: Mapping[str, PluginManifest]) -> list[NamedDevice]:
    """Return the devices that robots' plugins name, each once a robot."""
    found: dict[NamedDevice, None] = {}
    for robot in robots:
        for plugin in robot.plugins.values():
            manifest = manifests.get(plugin.plugin)
            sections = manifest.file.devices if manifest is not None else ()
            found |= dict.fromkeys(_devices_of(robot.name, plugin, {one.setting: one for one in sections}))
    return list(found)


def _devices_of(robot: str, plugin: PluginSettings, sections: Mapping[str, DeviceSection]) -> Iterator[NamedDevice]:
    for key, value in plugin.settings.items():
        section = sections.get(key, DeviceSection(setting=key))
        paths = [text for text in texts_in(value) if text.startswith("/dev/")]
        if section.kind == "camera" and type(value) is int:
            paths.append(f"/dev/video{value}")
        for path in paths:
            yield NamedDevice(robot, Path(path), section.kind, section.usb, section.group)


def check_devices(devices: Iterable[NamedDevice]) -> Iterator[Diagnostic]:
    """Yield the findings on devices of this machine."""
    for device in devices:
        facts = read_facts(device.path)
        yield judge_device(device, facts, user_name(), _others_like(device))
        if device.kind == "camera" and facts.is_device and facts.usable:
            yield judge_camera(device, _capabilities(device.path))


def read_facts(path: Path) -> DeviceFacts:
    """Return the system's information on a path."""
    try:
        status = path.stat()
    except OSError:
        return DeviceFacts(exists=False)
    group = group_of(path)
    try:
        members = grp.getgrnam(group).gr_mem
    except KeyError:  # no group, or one of another system
        members = []
    return DeviceFacts(
        exists=True,
        is_device=stat.S_ISCHR(status.st_mode),
        is_terminal=_is_terminal(status.st_rdev),
        usable=os.access(path, os.R_OK | os.W_OK),
        group=group,
        is_member=user_name() in members,
    )


def _is_terminal(device: int) -> bool | None:
    try:
        drivers = _TERMINAL_DRIVERS.read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return os.major(device) in {int(line.split()[2]) for line in drivers}


def judge_device(device: NamedDevice, facts: DeviceFacts, user: str, others: Iterable[str] = ()) -> Diagnostic:
    """Return whether a plugin will be able to open its device; `others` are similar devices, for the advice."""
    name = f"{device.path} of {device.robot}"
    if not facts.exists:
        there = ", ".join(others)
        hint = f"There is {there}. " if there else ""
        return problem(_AREA, f"{name} is not there", f"{hint}Switch it on and plug it in, or correct the fleet file.")
    if not facts.is_device:
        return problem(_AREA, f"{name} is not a device", "Name the device itself in the fleet file.")
    if device.kind == "serial" and facts.is_terminal is False:
        there = f": {', '.join(others)}" if others else ""
        return problem(_AREA, f"{name} is no serial port", f"Name a serial port; `eal ports` lists them{there}.")
    if facts.usable:
        return ok(_AREA, f"{name} is there and may be used")
    if not facts.group:
        advice = f"No group may use it: add a udev rule with a group, such as {device.group}, and put {user} in it."
    elif facts.is_member:
        advice = f"{user} is in the group {facts.group}, but not in this session: log out and in again."
    else:
        advice = f"sudo usermod -aG {facts.group} {user}; then log out and in again."
    return problem(_AREA, f"{name} may not be used by {user}", advice)


def judge_camera(device: NamedDevice, capabilities: bytes | None) -> Diagnostic:
    """Return whether a device captures pictures, by its `struct v4l2_capability`; None if it has none."""
    where = f"{device.path} of {device.robot}"
    if capabilities is None:
        return problem(_CAMERAS, f"{where} is no camera", "Name another one: v4l2-ctl --list-devices")
    _, card, _, _, whole, own = _CAPABILITIES.unpack(capabilities)
    name = card.partition(b"\0")[0].decode("utf-8", "replace")
    if (own if whole & _HAS_DEVICE_CAPABILITIES else whole) & _CAPTURES:
        return ok(_CAMERAS, f"{where} is {name}")
    advice = "Cameras often have a second device for other data; name the first one: v4l2-ctl --list-devices"
    return warning(_CAMERAS, f"{where} belongs to {name}, but gives no pictures", advice)


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


def _others_like(device: NamedDevice) -> list[str]:
    """Return existing devices of the same kind; those with a declared USB id come first, with the id."""
    stem = device.path.name.rstrip("0123456789")
    patterns = _SERIAL_PORTS if stem.startswith("tty") or device.usb else (f"{stem}[0-9]*",)
    found = [path for pattern in patterns for path in sorted(Path("/dev").glob(pattern))]
    ids = {path: identity for path in found if (identity := usb_id(path)) in device.usb}
    found.sort(key=lambda path: path not in ids)
    return [f"{path} ({ids[path]})" if path in ids else str(path) for path in found][:_MOST_OTHERS]
