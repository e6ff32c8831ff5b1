"""A link through a pair of motes: active messages carry the Roomba's bytes, in both directions."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

from typing_extensions import override

from eal_actors.plugin import Clock, DataError, UnavailableError, get_logger

from .link import Port, PortLink
from .tinyos import FLAG, Ack, TinyosFraming

ACK_TIMEOUT_S: Final = 0.1
"""Longest time until a packet is sent again; less if acknowledgements are fast."""
_LEAST_ACK_S: Final = 0.03
_ACKS: Final = 3  # time limit of an acknowledgement, in measured delays
MOST_WAITING: Final = 32
"""Longest send queue, in packets."""
_CHUNK_BYTES: Final = 4096
_REPEATS: Final = 3
_READING_LASTS_S: Final = 1.0
_CLOSING_FLAG: Final = bytes([FLAG])


class MoteLink(PortLink):
    """A link to the base mote at a serial port, whose radio reaches the mote on the robot.

    One packet at a time is in flight to the base mote. A packet without an acknowledgement is sent again. The mote
    forwards it again too if only the acknowledgement was lost, so every command must be safe to repeat. The
    acknowledgement does not cover the radio: the user of the link must handle losses there. A question is sent
    without an acknowledgement, because the time of the answer to a repeated question is unknown.

    Args:
        port: of the base mote; its read must not wait.
        tries: number of transmissions of a packet before the link fails.
    """

    repeats: Final = _REPEATS
    reading_lasts_s: Final = _READING_LASTS_S

    def __init__(self, port: Port, clock: Clock, framing: TinyosFraming, tries: int) -> None:
        super().__init__(port)
        self._clock = clock
        self._framing = framing
        self._tries = tries
        self._deframer = framing.deframer()
        self._waiting: deque[bytes] = deque()
        self._in_flight: bytes | None = None
        self._sequence = 0
        self._attempts = 0
        self._sent_s = self._acked_s = self._unsure_since_s = 0.0
        self._is_unsure = False
        self._ack_s = ACK_TIMEOUT_S
        self._opening = 0
        self._received = bytearray()
        self._log = get_logger(port=port.name)

    @property
    @override
    def is_busy(self) -> bool:
        return self._in_flight is not None or bool(self._waiting)

    @property
    @override
    def unsure_s(self) -> tuple[float, float]:
        return self._unsure_since_s, math.inf if self._is_unsure else self._acked_s

    @override
    def send(self, data: bytes, *, supersedes: bool = False) -> None:
        self._exchange()
        if supersedes:
            self._waiting = deque(packet for packet in self._waiting if packet[:1] != data[:1])
            if self._in_flight is not None and self._in_flight[:1] == data[:1]:
                self._in_flight = None
                self._is_unsure = True
        packets = self._packets(data)
        if len(self._waiting) + len(packets) > MOST_WAITING:
            self._waiting.clear()
            raise UnavailableError(f"the mote on {self.name} is too slow: {MOST_WAITING} packets wait; all are dropped")
        self._waiting += packets
        self._exchange()

    @override
    def ask(self, data: bytes) -> None:
        self._exchange()
        for packet in self._packets(data):
            self._write(packet, None)

    def urge(self, data: bytes) -> None:
        """Send bytes at once, without waiting for the acknowledgement of the packet in flight."""
        self._reset_if_reopened()
        self._waiting = deque(self._packets(data))
        self._in_flight = None
        self._exchange()

    @override
    def receive(self) -> bytes:
        self._exchange()
        received = bytes(self._received)
        self._received.clear()
        return received

    def pull_device_detect(self, *, low: bool) -> None:
        """Do nothing: the motes have no such line."""

    def _packets(self, data: bytes) -> list[bytes]:
        most = self._framing.payload_bytes
        return [data[start : start + most] for start in range(0, len(data), most)]

    def _exchange(self) -> None:
        """Process the received bytes, and send the next packet if it is due."""
        self._reset_if_reopened()
        data = bytes(self._port.read(_CHUNK_BYTES))
        for body in self._deframer.feed(data):
            self._take(body)
        if not data and (last := self._deframer.finish()) is not None:
            self._take(last)
        if self._in_flight is None:
            self._send_next()
        elif self._clock.now() - self._sent_s >= self._ack_s:
            self._send_again()

    def _reset_if_reopened(self) -> None:
        """Reset the link after the port was reopened."""
        if self._port.openings != self._opening:
            self._opening = self._port.openings
            self._deframer = self._framing.deframer()
            self._received.clear()
            self._waiting.clear()
            self._in_flight = None

    def _take(self, body: bytes) -> None:
        try:
            read = self._framing.read(body)
        except DataError as error:
            self._log.debug("a frame is dropped", reason=error.message)
            return
        if isinstance(read, Ack):
            if self._in_flight is not None and read.sequence == self._sequence:
                self._in_flight = None
                self._acked_s, self._is_unsure = self._sent_s, False
                if self._attempts == 1:
                    self._ack_s = min(max(_ACKS * (self._clock.now() - self._sent_s), _LEAST_ACK_S), ACK_TIMEOUT_S)
        elif read.sequence is None and self._framing.is_ours(read):  # with one, it is an echo of ours
            self._received += read.payload

    def _send_next(self) -> None:
        if self._waiting:
            self._in_flight = self._waiting.popleft()
            self._sequence = (self._sequence + 1) % 256
            self._attempts = 0
            if not self._is_unsure:
                self._unsure_since_s, self._is_unsure = self._clock.now(), True
            self._transmit(self._in_flight)

    def _send_again(self) -> None:
        if self._in_flight is None:
            return
        if self._attempts >= self._tries:
            self._in_flight = None
            self._waiting.clear()
            raise UnavailableError(
                f"the mote on {self.name} does not acknowledge: packet {self._sequence} was sent {self._attempts} times"
            )
        self._transmit(self._in_flight)

    def _transmit(self, payload: bytes) -> None:
        self._write(payload, self._sequence)
        self._attempts += 1
        self._sent_s = self._clock.now()

    def _write(self, payload: bytes, sequence: int | None) -> None:
        """Write a packet, with a second closing flag: without any, it would arrive when the next packet begins."""
        self._port.write(self._framing.packet(payload, sequence) + _CLOSING_FLAG)
