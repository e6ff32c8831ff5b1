"""Emulators as programs: served on a wire until a signal ends them, if wanted at the pace of a line."""

from __future__ import annotations

import math
import signal
import sys
from collections.abc import Callable
from typing import Final, NoReturn, Protocol

from eal_actors.device.emulator_wires import LOCAL, TICK_S, WIRES, DeviceEmulator
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.posix import HAS_TERMINALS

_BITS_A_BYTE: Final = 10  # a start bit, eight and a stop bit


class LinePace:
    """Bytes in flight, which arrive at a baud rate. `baud_rate` is None for no delay."""

    def __init__(self, baud_rate: int | None) -> None:
        self._byte_s = _BITS_A_BYTE / baud_rate if baud_rate else 0.0
        self._waiting = bytearray()
        self._free_s = -math.inf

    def put(self, data: bytes, now_s: float) -> None:
        """Send bytes."""
        if data and not self._waiting:
            self._free_s = max(self._free_s, now_s)
        self._waiting += data

    def take(self, now_s: float) -> bytes:
        """Return the bytes that have arrived by now."""
        count = len(self._waiting)
        if self._byte_s and count:
            count = min(count, max(0, math.floor((now_s - self._free_s) / self._byte_s + 1e-6)))
            self._free_s += count * self._byte_s
        arrived = bytes(self._waiting[:count])
        del self._waiting[:count]
        return arrived


class PacedEmulator:
    """An emulator at a line with a baud rate. Thread: its wire's. `baud_rate` is None for no delay."""

    def __init__(self, emulator: DeviceEmulator, baud_rate: int | None) -> None:
        self._emulator = emulator
        self._incoming, self._outgoing = LinePace(baud_rate), LinePace(baud_rate)

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Process bytes from the line, possibly none, and return the bytes that have arrived at its other end."""
        self._incoming.put(data, now_s)
        self._outgoing.put(self._emulator.feed(self._incoming.take(now_s), now_s), now_s)
        return self._outgoing.take(now_s)


class EmulatedBody(Protocol):
    """The body of an emulated robot."""

    @property
    def pose(self) -> tuple[float, float, float]:
        """Its x and y in m, and its yaw in rad."""


class _EndedError(BaseException):
    """A signal has ended the program."""


def serve_emulator(
    wire: str,
    make: Callable[[Callable[[], float]], tuple[DeviceEmulator, EmulatedBody | None]],
    *,
    at: tuple[str, int] = LOCAL,
    scheme: str = "",
    tick_s: float = TICK_S,
) -> None:
    """Serve an emulator until Ctrl-C or SIGTERM; print its address first, and the robot's pose at the end.

    Args:
        wire: `pty`, `tcp` or `udp`.
        make: returns the emulator and its body, if it has one, from a function that returns the time in seconds.
        at: where to listen; port 0 takes any port. A pseudo-terminal needs no address.
        scheme: prefix of the address, such as `udp://`.
        tick_s: real seconds between calls of the emulator without input.

    Thread: the main one; blocks it.
    """
    if wire == "pty" and not HAS_TERMINALS:
        raise SystemExit("this system has no pseudo-terminals")
    emulator, body = make(REAL_TIME.now)
    served = WIRES[wire](lambda: emulator, tick_s, at)
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, _end)
        served.plug_in()
        _print(f"{scheme}{served.address}")
        served.join()
        raise SystemExit(1)  # it has failed, and its thread has printed why
    except _EndedError:
        pass
    finally:
        served.close()
    if body is not None:
        x_m, y_m, yaw_rad = body.pose
        _print(f"pose {x_m:.4f} m {y_m:.4f} m {math.degrees(yaw_rad):.2f} deg")


def _end(*_: object) -> NoReturn:
    raise _EndedError


def _print(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()
