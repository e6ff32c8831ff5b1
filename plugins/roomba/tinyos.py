"""Packets of TinyOS on a serial line: encoding and decoding of bytes.

A frame is `7E | escaped(body | CRC) | 7E`. The body begins with a protocol byte: an acknowledgement, a packet with
acknowledgement, or a packet without. A packet carries an active message.

Source: TinyOS TEP 113, "Serial Communication", and TEP 111; for the older form, TinyOS 1.x's framer and its TOS_Msg.
"""

from __future__ import annotations

import binascii
import enum
import struct
from dataclasses import dataclass
from typing import Final, TypeAlias

from eal_actors.plugin import ArgumentError, DataError

FLAG: Final = 0x7E
ESCAPE: Final = 0x7D
_FLIP: Final = 0x20
_CRC_BYTES: Final = 2
_DISPATCH_AM: Final = 0


class Header(enum.StrEnum):
    """The forms of packets."""

    TINYOS_1 = "tinyos1"
    TINYOS_2 = "tinyos2"


_PROTOCOL_BYTES: Final = {Header.TINYOS_2: (0x43, 0x44, 0x45), Header.TINYOS_1: (0x40, 0x41, 0x42)}
"""Of each form: acknowledgement, packet with and packet without acknowledgement."""


def crc(body: bytes) -> int:
    """Return the CRC of a frame's body: polynomial 0x1021 from 0, unreflected."""
    return binascii.crc_hqx(body, 0)


def frame(body: bytes) -> bytes:
    """Frame a body for the line."""
    framed = bytearray([FLAG])
    for byte in body + struct.pack("<H", crc(body)):
        framed += bytes([ESCAPE, byte ^ _FLIP]) if byte in (FLAG, ESCAPE) else bytes([byte])
    framed.append(FLAG)
    return bytes(framed)


class Deframer:
    """Finds frames in the bytes of a line, in pieces of any size, and drops the rest.

    Args:
        longest_bytes: longest body with its CRC.

    Attributes:
        dropped: number of broken frames: a wrong CRC, too short or too long.
    """

    def __init__(self, longest_bytes: int) -> None:
        self.dropped = 0
        self._longest_bytes = longest_bytes
        self._held = bytearray()
        self._is_escaped = False
        self._is_lost = True  # until the first flag

    def feed(self, data: bytes) -> list[bytes]:
        """Process bytes; return the bodies of the completed frames."""
        bodies = []
        for byte in data:
            if byte == FLAG:
                if (body := self._end()) is not None:
                    bodies.append(body)
            elif not self._is_lost:
                self._hold(byte)
        return bodies

    def finish(self) -> bytes | None:
        """Return the body of a whole frame whose closing flag is lost, when the line is silent; else None.

        The opening flag of a later frame would complete it, and it would pass for the answer to a later question.
        """
        held = bytes(self._held)
        body, received = held[:-_CRC_BYTES], held[-_CRC_BYTES:]
        if self._is_lost or self._is_escaped or not body or received != struct.pack("<H", crc(body)):
            return None
        self._held.clear()
        self._is_lost = True  # until the next flag
        return body

    def _hold(self, byte: int) -> None:
        if byte == ESCAPE and not self._is_escaped:
            self._is_escaped = True
            return
        self._held.append(byte ^ _FLIP if self._is_escaped else byte)
        self._is_escaped = False
        if len(self._held) > self._longest_bytes:
            self.dropped += 1
            self._is_lost = True

    def _end(self) -> bytes | None:
        held, was_cut = bytes(self._held), self._is_escaped  # a frame never ends in the middle of an escape
        was_lost = self._is_lost
        self._held.clear()
        self._is_escaped = self._is_lost = False
        if was_lost or not held:  # between two frames there may be one flag or two
            return None
        body, received = held[:-_CRC_BYTES], held[-_CRC_BYTES:]
        if was_cut or not body or received != struct.pack("<H", crc(body)):
            self.dropped += 1
            return None
        return body


@dataclass(frozen=True, slots=True)
class Ack:
    """An acknowledgement.

    Attributes:
        sequence: of the packet that came, 0..255.
    """

    sequence: int


@dataclass(frozen=True, slots=True)
class Packet:
    """An active message.

    Attributes:
        payload: its content.
        sequence: 0..255 with acknowledgement; None without.
        am_type: active message type, 0..255.
        group: 0..255.
        destination: address, 0..65535.
        source: address, 0..65535; TinyOS 1.x does not send it.
    """

    payload: bytes
    sequence: int | None
    am_type: int
    group: int
    destination: int
    source: int = 0


Body: TypeAlias = Ack | Packet


@dataclass(frozen=True, slots=True)
class TinyosFraming:
    """The form of packets, the same at both ends.

    Attributes:
        header: TinyOS 1.x or 2.x.
        ack_byte: protocol byte of an acknowledgement; that of the form if None. Likewise the others.
        am_type: of the packets that are sent, and that are not ignored.
        destination: of the packets that are sent.
        group: of the packets that are sent, and that are not ignored.
        payload_bytes: largest payload of a packet.

    Raises:
        ArgumentError: two protocol bytes are the same.
    """

    header: Header = Header.TINYOS_2
    ack_byte: int | None = None
    reliable_byte: int | None = None
    plain_byte: int | None = None
    am_type: int = 0x89
    destination: int = 0xFFFF
    group: int = 0x22
    payload_bytes: int = 28

    def __post_init__(self) -> None:
        if len(set(self._bytes)) < 3:
            shown = ", ".join(f"0x{byte:02X}" for byte in self._bytes)
            raise ArgumentError(f"TinyOS: the three protocol bytes must differ, not {shown}")

    @property
    def _bytes(self) -> tuple[int, int, int]:
        """The protocol bytes: acknowledgement, packet with and packet without acknowledgement."""
        usual = _PROTOCOL_BYTES[self.header]
        own = (self.ack_byte, self.reliable_byte, self.plain_byte)
        ack, reliable, plain = (other if byte is None else byte for byte, other in zip(own, usual, strict=True))
        return ack, reliable, plain

    @property
    def longest_bytes(self) -> int:
        """Maximum size of a body and its CRC."""
        return 3 + 8 + self.payload_bytes + _CRC_BYTES

    def deframer(self) -> Deframer:
        """Return a new deframer for a line of this form."""
        return Deframer(self.longest_bytes)

    def ack(self, sequence: int) -> bytes:
        """Return the frame of an acknowledgement."""
        return frame(bytes([self._bytes[0], sequence]))

    def packet(self, payload: bytes, sequence: int | None) -> bytes:
        """Return the frame of a packet; one with a sequence number is acknowledged.

        Raises:
            ArgumentError: the payload is too long.
        """
        if len(payload) > self.payload_bytes:
            raise ArgumentError(f"TinyOS: a payload has {self.payload_bytes} bytes at most, not {len(payload)}")
        _, reliable, plain = self._bytes
        start = bytes([plain]) if sequence is None else bytes([reliable, sequence])
        return frame(start + self._header(len(payload)) + payload)

    def _header(self, length: int) -> bytes:
        if self.header is Header.TINYOS_1:
            return struct.pack("<HBBB", self.destination, self.am_type, self.group, length)
        return struct.pack(">BHHBBB", _DISPATCH_AM, self.destination, 0, length, self.group, self.am_type)

    def read(self, body: bytes) -> Body:
        """Read a frame's body.

        Raises:
            DataError: it is neither an acknowledgement nor a whole packet.
        """
        ack, reliable, plain = self._bytes
        if body[:1] == bytes([ack]):
            if len(body) != 2:
                raise DataError(f"TinyOS: an acknowledgement has 2 bytes, not {len(body)}")
            return Ack(body[1])
        if body[:1] == bytes([reliable]) and len(body) >= 2:
            return self._read_packet(body[2:], body[1])
        if body[:1] == bytes([plain]):
            return self._read_packet(body[1:], None)
        raise DataError(f"TinyOS: no frame begins with {body[:2].hex(' ') or 'nothing'}")

    def _read_packet(self, data: bytes, sequence: int | None) -> Packet:
        size = 5 if self.header is Header.TINYOS_1 else 8
        if len(data) < size:
            raise DataError(f"TinyOS: a packet's header has {size} bytes, not {len(data)}")
        source, payload = 0, data[size:]
        if self.header is Header.TINYOS_1:
            destination, am_type, group, length = struct.unpack("<HBBB", data[:size])
        else:
            dispatch, destination, source, length, group, am_type = struct.unpack(">BHHBBB", data[:size])
            if dispatch != _DISPATCH_AM:
                raise DataError(f"TinyOS: dispatch byte {dispatch} is no active message")
        if length != len(payload):
            raise DataError(f"TinyOS: a packet says it carries {length} bytes, and has {len(payload)}")
        return Packet(payload, sequence, am_type, group, destination, source)

    def is_ours(self, packet: Packet) -> bool:
        """Return whether a packet has our type and group."""
        return packet.am_type == self.am_type and packet.group == self.group
