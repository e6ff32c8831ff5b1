"""A Link through a pair of motes: the Roomba's bytes travel as the payload of active messages, both ways."""

from __future__ import annotations

from collections import deque
from typing import Final

from typing_extensions import override

from eal_actors.plugin import Clock, DataError, UnavailableError, get_logger

from .link import Port, RoombaLink
from .tinyos import Ack, TinyosFraming

ACK_TIMEOUT_S: Final = 0.1
MOST_WAITING: Final = 32
"""Packets that may wait to be sent."""
_CHUNK_BYTES: Final = 4096
_REPEATS: Final = 3
_READING_LASTS_S: Final = 1.0


class MoteLink(RoombaLink):
    """A Link to the base mote at a serial port, whose radio reaches the mote on the robot.

    One packet at a time is under way to the base mote. One that is not acknowledged is sent again, with the same
    sequence number, so that the mote does not forward it twice. The acknowledgement says nothing of the radio: what
    gets lost there is the matter of who uses the link.

    Args:
        port: of the base mote; its read must not wait.
        clock: the fleet's clock.
        framing: the form of the packets.
        tries: how often a packet is sent in all before the link gives up.
    """

    repeats: Final = _REPEATS
    reading_lasts_s: Final = _READING_LASTS_S

    def __init__(self, port: Port, clock: Clock, framing: TinyosFraming, tries: int) -> None:
        self._port = port
        self._clock = clock
        self._framing = framing
        self._tries = tries
        self._deframer = framing.deframer()
        self._waiting: deque[bytes] = deque()
        self._under_way: bytes | None = None
        self._sequence = 0
        self._tried = 0
        self._sent_s = 0.0
        self._opening = 0
        self._received = bytearray()
        self._log = get_logger(port=port.name)

    @property
    @override
    def name(self) -> str:
        return self._port.name

    @property
    @override
    def openings(self) -> int:
        return self._port.openings

    @property
    @override
    def is_busy(self) -> bool:
        return self._under_way is not None or bool(self._waiting)

    @override
    def why_not_ready(self) -> str | None:
        return self._port.why_not_ready()

    def send(self, data: bytes, *, supersedes: bool = False) -> None:
        """See Link.

        Raises:
            UnavailableError: too much waits, the mote does not acknowledge, or the port is broken.
        """
        self._go_on()
        if supersedes:
            self._waiting = deque(packet for packet in self._waiting if packet[:1] != data[:1])
        packets = self._packets(data)
        if len(self._waiting) + len(packets) > MOST_WAITING:
            self._waiting.clear()
            raise UnavailableError(f"the mote on {self.name} is too slow: {MOST_WAITING} packets wait; all are dropped")
        self._waiting += packets
        self._go_on()

    def urge(self, data: bytes) -> None:
        """See Link: it does not even wait for the acknowledgement of the packet that is under way."""
        self._greet_if_new()
        self._waiting = deque(self._packets(data))
        self._under_way = None
        self._go_on()

    def receive(self) -> bytes:
        """See Link.

        Raises:
            UnavailableError: the mote does not acknowledge, or the port is broken.
        """
        self._go_on()
        received = bytes(self._received)
        self._received.clear()
        return received

    def pull_device_detect(self, *, low: bool) -> None:
        """See Link: the motes have no such line."""

    @override
    def close(self) -> None:
        self._port.close()

    def _packets(self, data: bytes) -> list[bytes]:
        most = self._framing.payload_bytes
        return [data[start : start + most] for start in range(0, len(data), most)]

    def _go_on(self) -> None:
        """Take what came, and send what is due."""
        self._greet_if_new()
        for body in self._deframer.feed(bytes(self._port.read(_CHUNK_BYTES))):
            self._take(body)
        if self._under_way is None:
            self._send_next()
        elif self._clock.now() - self._sent_s >= ACK_TIMEOUT_S:
            self._send_again()

    def _greet_if_new(self) -> None:
        """Reset the link after the port was reopened.

        The first packet carries nothing: if the mote has heard its number just before, it does not forward it.
        """
        if self._port.openings != self._opening:
            self._opening = self._port.openings
            self._deframer = self._framing.deframer()
            self._received.clear()
            self._waiting = deque([b""])
            self._under_way = None

    def _take(self, body: bytes) -> None:
        try:
            read = self._framing.read(body)
        except DataError as error:
            self._log.debug("a frame is dropped", reason=error.message)
            return
        if isinstance(read, Ack):
            if self._under_way is not None and read.sequence == self._sequence:
                self._under_way = None
        elif read.sequence is None and self._framing.is_ours(read):  # with one, it is an echo of ours
            self._received += read.payload

    def _send_next(self) -> None:
        if self._waiting:
            self._under_way = self._waiting.popleft()
            self._sequence = (self._sequence + 1) % 256
            self._tried = 0
            self._transmit(self._under_way)

    def _send_again(self) -> None:
        if self._under_way is None:
            return
        if self._tried >= self._tries:
            self._under_way = None
            self._waiting.clear()
            raise UnavailableError(
                f"the mote on {self.name} does not acknowledge: packet {self._sequence} was sent {self._tried} times"
            )
        self._transmit(self._under_way)

    def _transmit(self, payload: bytes) -> None:
        self._port.write(self._framing.packet(payload, self._sequence))
        self._tried += 1
        self._sent_s = self._clock.now()
