"""A serial line that damages bytes, between a driver and the byte-level emulator of its device.

The line is in memory: a pseudo-terminal hands each byte on in a thread of the kernel, which took most of the time of a
run. Other tests have the drivers' real ports. No thread runs: the device is advanced in fixed ticks whenever the driver
reads or writes. So a run depends on nothing but its seed, however busy the machine is.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from random import Random
from typing import Final, Protocol

from eal_actors.plugin import BytePort

KINDS: Final = ("flip", "drop", "double", "insert")
TICK_S: Final = 0.005
"""Interval in which the device is advanced."""

_BITS_A_BYTE: Final = 10


class ByteDevice(Protocol):
    """Bytes in, bytes out."""

    def feed(self, data: bytes, now_s: float) -> bytes: ...


@dataclass(frozen=True)
class Noise:
    """The faults of a line.

    Attributes:
        rate: share of the bytes that are damaged, 0..1.
        kinds: the kinds of damage, of which each damaged byte has one by chance.
    """

    rate: float = 0.0
    kinds: tuple[str, ...] = KINDS


@dataclass(frozen=True)
class Line:
    """The delays of a line.

    Attributes:
        baud_rate: pace of the bytes.
        there_s: additional delay from the driver to the device.
        back_s: additional delay from the device to the driver.
    """

    baud_rate: int = 115200
    there_s: float = 0.0
    back_s: float = 0.0


class Damage:
    """Damages bytes by chance, and counts the faults."""

    def __init__(self, random: Random) -> None:
        self.counts: Counter[str] = Counter()
        self._random = random

    def carry(self, data: bytes, noise: Noise) -> bytes:
        """Return the bytes that arrive."""
        if not noise.rate:
            return data
        arrived = bytearray()
        for byte in data:
            if self._random.random() >= noise.rate:
                arrived.append(byte)
                continue
            kind = self._random.choice(noise.kinds)
            self.counts[kind] += 1
            if kind == "flip":
                arrived.append(byte ^ 1 << self._random.randrange(8))
            elif kind == "double":
                arrived += bytes([byte, byte])
            elif kind == "insert":
                arrived += bytes([self._random.randrange(256), byte])
        return bytes(arrived)


class Flight:
    """Bytes on their way in one direction."""

    def __init__(self, byte_s: float, delay_s: float) -> None:
        self._byte_s, self._delay_s = byte_s, delay_s
        self._bytes: deque[tuple[float, int]] = deque()
        self._free_s = 0.0

    def put(self, data: bytes, now_s: float) -> None:
        self._free_s = max(self._free_s, now_s)
        for byte in data:
            self._free_s += self._byte_s
            self._bytes.append((self._free_s + self._delay_s, byte))

    def take(self, now_s: float) -> bytes:
        """Return the bytes that have arrived by now."""
        arrived = bytearray()
        while self._bytes and self._bytes[0][0] <= now_s:
            arrived.append(self._bytes.popleft()[1])
        return bytes(arrived)


class NoisyWire(BytePort):
    """The driver's port, with the device at its other end.

    Args:
        make: makes the device from a function that returns the device's time.
        clock: returns the driver's time.
        random: of the damage.
        line: its delays.

    Attributes:
        device: the emulator.
        noise: the present faults; a test changes them.
        damage: counts the faults so far.
        is_cut: whether nothing comes through, either way.
    """

    def __init__(
        self,
        make: Callable[[Callable[[], float]], ByteDevice],
        clock: Callable[[], float],
        random: Random,
        line: Line | None = None,
    ) -> None:
        line = line or Line()
        self.noise = Noise()
        self.damage = Damage(random)
        self.is_cut = False
        self._clock = clock
        self._device_s = clock()
        self.device = make(lambda: self._device_s)
        byte_s = _BITS_A_BYTE / line.baud_rate
        self._there, self._back = Flight(byte_s, line.there_s), Flight(byte_s, line.back_s)
        self._arrived = bytearray()

    # The driver's side.

    @property
    def in_waiting(self) -> int:
        self._arrive()
        return len(self._arrived)

    def write(self, data: bytes) -> int:
        self._advance()
        if not self.is_cut:
            self._there.put(self.damage.carry(data, self.noise), self._clock())
        self._advance()
        return len(data)

    def read(self, size: int = 1) -> bytes:
        self._arrive()
        data = bytes(self._arrived[:size])
        del self._arrived[:size]
        return data

    def reset_input_buffer(self) -> None:
        self._arrive()
        self._arrived.clear()

    def close(self) -> None:
        self._advance()

    # The device's side.

    def _arrive(self) -> None:
        """Take what has arrived by now."""
        self._advance()
        self._arrived += self._back.take(self._clock())

    def _advance(self) -> None:
        """Let the device do what it does until now."""
        now_s = self._clock()
        while self._device_s < now_s:
            self._device_s = min(self._device_s + TICK_S, now_s)
            self._feed()
        self._feed()

    def _feed(self) -> None:
        reply = self.device.feed(self._there.take(self._device_s), self._device_s)
        if reply and not self.is_cut:
            self._back.put(self.damage.carry(reply, self.noise), self._device_s)

    def settle(self) -> None:
        """Advance the device to the driver's time."""
        self._advance()
