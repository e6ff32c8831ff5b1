"""Input devices of Linux, and streams of their events: a pipe, a FIFO or a file that another program writes."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eal_actors.kernel.errors import ArgumentError, UnavailableError
from eal_actors.operate.hands.sticks import ABS_X, ABS_Y, BTN_SOUTH, EV_ABS, EV_KEY, KEYS, AxisRange

_INPUT_MAJOR: Final = 13  # the major number of Linux's input devices
_FOLDER: Final = Path("/dev/input")


@dataclass(frozen=True, slots=True)
class InputSource:
    """An open device. Its descriptor does not block; `ranges` are those of its axes, by code."""

    name: str
    fd: int
    ranges: Mapping[int, AxisRange]

    def close(self) -> None:
        """Close it."""
        os.close(self.fd)


def find_input(device: Path | None = None) -> InputSource:
    """Open a device; without a path, the first gamepad.

    Raises:
        UnavailableError: there is none, or it cannot be opened.
        ArgumentError: it has neither a gamepad's buttons nor the keys that drive.
    """
    if device is not None:
        return _open(device)
    found = sorted(_FOLDER.glob("event*"), key=lambda path: int(path.name.removeprefix("event") or 0))
    refused: list[str] = []
    for path in found:
        try:
            return _open(path, needs_gamepad=True)
        except (UnavailableError, ArgumentError) as error:
            refused.append(f"{path}: {error.message}")
    what = "; ".join(refused) if refused else f"{_FOLDER} has no devices"
    raise UnavailableError(f"no gamepad: {what}. Plug one in, or give --device")


def _open(path: Path, *, needs_gamepad: bool = False) -> InputSource:
    try:
        about = path.stat()
        is_device = stat.S_ISCHR(about.st_mode) and os.major(about.st_rdev) == _INPUT_MAJOR
        fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    except PermissionError:
        raise UnavailableError(f"{path} may not be read: `sudo usermod -aG input $USER`, then log in again") from None
    except OSError as error:
        raise UnavailableError(f"{path} cannot be opened: {error.strerror}") from error
    if not is_device:
        return InputSource(str(path), fd, {})
    try:
        return _described(path, fd, needs_gamepad=needs_gamepad)
    except BaseException:
        os.close(fd)
        raise


def _described(path: Path, fd: int, *, needs_gamepad: bool) -> InputSource:
    import evdev  # an extra

    try:
        device: Any = evdev.InputDevice(path)
        abilities, name = device.capabilities(absinfo=True), device.name
        device.close()
    except OSError as error:
        raise UnavailableError(f"{path} cannot be read: {error.strerror}") from error
    keys = set(abilities.get(EV_KEY, ()))
    axes = {code: about for code, about in abilities.get(EV_ABS, ()) if code in (ABS_X, ABS_Y)}
    is_gamepad = BTN_SOUTH in keys and len(axes) == 2  # both axes of the stick
    if not is_gamepad and (needs_gamepad or not KEYS.keys() & keys):
        raise ArgumentError(f"{name} is no gamepad")
    return InputSource(name, fd, {code: AxisRange(about.min, about.max) for code, about in axes.items()})
