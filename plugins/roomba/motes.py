"""A pair of motes between a serial line and a Roomba: the base mote at the line, and the mote on the robot.

Like the emulator of the Roomba behind them, they read no clock and open no port.
"""

from __future__ import annotations

import random
from collections import deque
from typing import Final, Protocol

from eal_actors.plugin import DataError

from .sci import drive
from .tinyos import Ack, TinyosFraming

WATCHDOG_S: Final = 1.0
_KEPT: Final = 10_000
_STOP: Final = drive(0)


class ByteEmulator(Protocol):
    """A device at the far end of a wire."""

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Process bytes from the wire and return the reply."""
        ...


class MotePair:
    """Both motes, and the radio between them.

    As the stock programs of TinyOS do, the base mote acknowledges every intact packet that asks for it, and forwards
    it, also one that repeats the last sequence number. The mote on the robot stops the Roomba after a time of silence.

    Args:
        robot: the Roomba at the far mote's serial port.
        framing: the form of the packets on the line.
        loss: share of lost radio packets, 0..1, in each direction.
        radio_tries: most transmissions of a radio packet, as in TinyOS's PacketLink.
        ack_loss: share of lost acknowledgements on the line.
        seed: of the losses.
        watchdog_s: silence after which the mote on the robot stops it.

    Attributes:
        forwarded: the latest payloads that reached the robot.
        duplicates: packets that repeated the last sequence number.
        lost: number of lost radio packets.
    """

    def __init__(
        self,
        robot: ByteEmulator,
        framing: TinyosFraming,
        *,
        loss: float = 0.0,
        ack_loss: float = 0.0,
        radio_tries: int = 1,
        seed: int = 0,
        watchdog_s: float = WATCHDOG_S,
    ) -> None:
        self.forwarded: deque[bytes] = deque(maxlen=_KEPT)
        self.duplicates = 0
        self.lost = 0
        self._robot, self._framing = robot, framing
        self._loss, self._ack_loss, self._radio_tries = loss, ack_loss, radio_tries
        self._random = random.Random(seed)  # noqa: S311  # it makes faults, not secrets
        self._deframer = framing.deframer()
        self._last_sequence: int | None = None
        self._watchdog_s = watchdog_s
        self._heard_s: float | None = None

    def lose(self, loss: float) -> None:
        """Set the share of lost radio packets, 0..1."""
        self._loss = loss

    @property
    def complaints(self) -> list[str]:
        """The complaints of the Roomba, for `eal plugin check`."""
        return list(getattr(self._robot, "complaints", ()))

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Process bytes from the line and return the base mote's output."""
        self._watch(now_s)
        reply = bytearray()
        for body in self._deframer.feed(data):
            reply += self._take(body, now_s)
        return bytes(reply + self._report(self._robot.feed(b"", now_s)))

    def _watch(self, now_s: float) -> None:
        if self._heard_s is not None and now_s - self._heard_s > self._watchdog_s:
            self._robot.feed(_STOP, now_s)
            self._heard_s = None

    def _take(self, body: bytes, now_s: float) -> bytes:
        try:
            packet = self._framing.read(body)
        except DataError:
            return b""
        if isinstance(packet, Ack):
            return b""
        reply = b""
        if packet.sequence is not None:
            reply = b"" if self._random.random() < self._ack_loss else self._framing.ack(packet.sequence)
            if packet.sequence == self._last_sequence:
                self.duplicates += 1
            self._last_sequence = packet.sequence
        if self._framing.is_ours(packet) and packet.payload and self._reaches():
            self._heard_s = now_s
            self.forwarded.append(packet.payload)
            reply += self._report(self._robot.feed(packet.payload, now_s))
        return reply

    def _report(self, data: bytes) -> bytes:
        """Send the Roomba's output through the radio and up the line."""
        most, sent = self._framing.payload_bytes, bytearray()
        for start in range(0, len(data), most):
            if self._reaches():
                sent += self._framing.packet(data[start : start + most], None)
        return bytes(sent)

    def _reaches(self) -> bool:
        for _ in range(self._radio_tries):
            if self._random.random() >= self._loss:
                return True
            self.lost += 1
        return False
