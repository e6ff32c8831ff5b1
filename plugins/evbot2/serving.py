"""Wires that lose messages, and the own time of a device, for an emulated base that a program serves."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Final

from .firmware import BaseEmulator

TICK_S: Final = 0.005
"""Tick interval of a served base."""

_LONGEST_STEP_S: Final = 0.05  # a process that is not served for longer has been starved


class FaultyWire:
    """Loses, duplicates and reorders messages in one direction; a delayed message arrives with a later one.

    Args:
        loss: share of the messages that are lost, 0..1.
        duplicate: share of the others that arrive twice, the second time possibly much later, 0..1.
        reorder: share of the others that are delayed, 0..1.
    """

    def __init__(self, random: Random, loss: float = 0.0, duplicate: float = 0.0, reorder: float = 0.0) -> None:
        self._random = random
        self._loss = loss
        self._duplicate = duplicate
        self._reorder = reorder
        self._held: list[bytes] = []

    def carry(self, piece: bytes) -> list[bytes]:
        """Take a message and return those that arrive now, in order of arrival."""
        arriving = []
        if self._random.random() >= self._loss:
            is_late = self._random.random() < self._reorder
            if not is_late:
                arriving.append(piece)
            if is_late or self._random.random() < self._duplicate:
                self._held.append(piece)
        while self._held and self._random.random() < 0.5:
            arriving.append(self._held.pop(self._random.randrange(len(self._held))))
        return arriving


class DeviceTime:
    """The time of an emulated device, which stands still while its process gets no processor time.

    So a busy computer makes the device slow, but its watchdog does not fire for messages that wait to be read.

    Args:
        now_s: returns the real time in seconds.
        rate: seconds of the device's time in one real second.
    """

    def __init__(self, now_s: Callable[[], float], rate: float = 1.0) -> None:
        self._now_s, self._rate = now_s, rate
        self._seen_s, self._passed_s = now_s(), 0.0

    def __call__(self) -> float:
        """Return the time in seconds since the start."""
        now_s = self._now_s()
        self._passed_s += min(now_s - self._seen_s, _LONGEST_STEP_S) * self._rate
        self._seen_s = now_s
        return self._passed_s


class ServedBase:
    """An emulated base behind two faulty wires, in its own time. Thread: its wire's.

    Args:
        now_s: returns the device's time, the same as that of its vehicle.
    """

    def __init__(
        self, device: BaseEmulator, now_s: Callable[[], float], incoming: FaultyWire, outgoing: FaultyWire
    ) -> None:
        self._device, self._now_s = device, now_s
        self._incoming, self._outgoing = incoming, outgoing

    def feed(self, data: bytes, now_s: float) -> bytes:  # noqa: ARG002  # the device has a time of its own
        """Pass a message to the base, and return the replies that arrive."""
        device_s = self._now_s()
        self._device.tick(device_s)
        arrived = self._incoming.carry(data) if data else []
        replies = [reply for piece in arrived for reply in self._device.replies(piece, device_s)]
        return b"".join(sent for reply in replies for sent in self._outgoing.carry(reply))
