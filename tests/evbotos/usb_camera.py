"""A USB camera (USB Video Class 1.0) at the other end of QEMU's `usb-redir`, which has no camera of its own.

The protocol is that of usbredir (`usbredirproto.h`), with the three extensions without which QEMU plugs nothing into an
xHCI: packets of type, length and number, each with a body of its own. What is sent is a grey picture in YUY2, black
at its left edge and white at its right; every tenth line of it wanders, so that no two pictures are the same.
"""

from __future__ import annotations

import socket
import struct
import threading
from contextlib import suppress
from pathlib import Path
from typing import Final, Self

from evbotos.qemu import Machine

HELLO, CONNECT, INTERFACES, ENDPOINTS = 0, 1, 4, 5
SET_CONFIGURATION, GET_CONFIGURATION, CONFIGURATION = 6, 7, 8
SET_ALTERNATIVE, GET_ALTERNATIVE, ALTERNATIVE = 9, 10, 11
CONTROL, BULK = 100, 101
SUCCESS, STALL = 0, 4
HIGH_SPEED: Final = 2
VIDEO, VIDEO_CONTROL, VIDEO_STREAMING = 14, 1, 2
CONTROL_TYPE, BULK_TYPE, NONE_TYPE = 0, 2, 255
STREAM_ENDPOINT: Final = 0x81
WIDTH, HEIGHT = 160, 120
FRAME_BYTES: Final = WIDTH * HEIGHT * 2
PAYLOAD_HEADER: Final = 2
INTERVAL: Final = 333_333
"""Of pictures, in 100 ns."""
NAME: Final = "Emulated Camera"

PACKET_SIZES, LONG_NUMBERS, LONG_BULK = 1 << 4, 1 << 5, 1 << 6
"""Extensions: an endpoint's largest packet is sent, a packet's number has 64 bits, a transfer's length has 32."""

_HELLO_HEADER: Final = struct.Struct("<III")
_HEADER: Final = struct.Struct("<IIQ")
_REQUEST: Final = struct.Struct("<BBBBHHH")
_TRANSFER: Final = struct.Struct("<BBHIH")


def _described(kind: int, body: bytes) -> bytes:
    return bytes([len(body) + 2, kind]) + body


def _own(subtype: int, body: bytes) -> bytes:
    """Return a descriptor of the video class."""
    return _described(0x24, bytes([subtype]) + body)


def _device() -> bytes:
    return _described(1, struct.pack("<HBBBBHHHBBBB", 0x0200, 0xEF, 2, 1, 64, 0x1D6B, 0x0102, 0x0100, 0, 1, 0, 1))


def _configuration() -> bytes:
    camera = _own(2, struct.pack("<BHBBHHHB", 1, 0x0201, 0, 0, 0, 0, 0, 2) + bytes(2))
    out = _own(3, struct.pack("<BHBBB", 2, 0x0101, 0, 1, 0))
    units = camera + out
    control_header = _own(1, struct.pack("<HHIBB", 0x0100, 13 + len(units), 48_000_000, 1, 1))
    yuy2 = bytes.fromhex("5955593200001000800000aa00389b71")
    format_ = _own(4, bytes([1, 1]) + yuy2 + bytes([16, 1, 0, 0, 0, 0]))
    rate = FRAME_BYTES * 8 * 30
    frame = _own(5, struct.pack("<BBHHIIIIBI", 1, 0, WIDTH, HEIGHT, rate, rate, FRAME_BYTES, INTERVAL, 1, INTERVAL))
    formats = format_ + frame
    stream_header = _own(1, struct.pack("<BHBBBBBBBB", 1, 14 + len(formats), STREAM_ENDPOINT, 0, 2, 0, 0, 0, 1, 0))
    body = b"".join(
        [
            _described(11, bytes([0, 2, VIDEO, 3, 0, 0])),
            _described(4, bytes([0, 0, 0, VIDEO, VIDEO_CONTROL, 0, 0])),
            control_header,
            units,
            _described(4, bytes([1, 0, 1, VIDEO, VIDEO_STREAMING, 0, 0])),
            stream_header,
            formats,
            _described(5, struct.pack("<BBHB", STREAM_ENDPOINT, 2, 512, 0)),
        ]
    )
    return _described(2, struct.pack("<HBBBBB", 9 + len(body), 2, 1, 0, 0x80, 50)) + body


def _probe() -> bytes:
    """Return what the camera would send: the one format that it has."""
    return struct.pack("<HBBIHHHHHII", 0, 1, 1, INTERVAL, 0, 0, 0, 0, 0, FRAME_BYTES, FRAME_BYTES + PAYLOAD_HEADER)


def _payload(number: int) -> bytes:
    """Return a picture as the camera sends it: its header says that it is whole, and which of two in turn it is."""
    lines = []
    for line in range(HEIGHT):
        shift = number if line % 10 == 0 else 0
        lines += [bytes((255 * ((column + shift) % WIDTH) // (WIDTH - 1), 128)) for column in range(WIDTH)]
    return bytes([PAYLOAD_HEADER, 0x82 | number & 1]) + b"".join(lines)


class UsbCamera:
    """Serves the camera at a socket until it is closed.

    Args:
        path: of the socket, to which QEMU connects.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._listener = socket.socket(socket.AF_UNIX)
        self._listener.bind(str(path))
        self._listener.listen(1)
        self._line = socket.socket(socket.AF_UNIX)
        self._sent, self._left = 0, b""
        self._thread = threading.Thread(target=self._serve, name="usb-camera")

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        for one in (self._line, self._listener):
            with suppress(OSError):  # QEMU has closed its end already
                one.shutdown(socket.SHUT_RDWR)
        self._thread.join(10)
        assert not self._thread.is_alive()
        self._line.close()
        self._listener.close()

    def plug_into(self, machine: Machine) -> None:
        address = {"type": "unix", "data": {"path": str(self._path)}}
        machine.ask("chardev-add", id="camera", backend={"type": "socket", "data": {"addr": address, "server": False}})
        machine.ask("device_add", driver="usb-redir", bus="usb.0", id="camera", chardev="camera")

    @staticmethod
    def unplug_from(machine: Machine) -> None:
        machine.ask("device_del", id="camera")

    def _serve(self) -> None:
        try:
            line, _ = self._listener.accept()
        except OSError:  # closed before anybody came
            return
        self._line.close()
        self._line = line
        with suppress(ConnectionError), line.makefile("rb") as packets:  # unplugged in the middle of a picture
            self._introduce()
            _, length, _ = _HELLO_HEADER.unpack(packets.read(_HELLO_HEADER.size))
            packets.read(length)
            while len(head := packets.read(_HEADER.size)) == _HEADER.size:
                kind, length, number = _HEADER.unpack(head)
                self._answer(kind, number, packets.read(length))

    def _introduce(self) -> None:
        hello = b"camera".ljust(64, b"\0") + struct.pack("<I", PACKET_SIZES | LONG_NUMBERS | LONG_BULK)
        self._line.sendall(_HELLO_HEADER.pack(HELLO, len(hello), 0) + hello)
        classes = [bytes([0, 1]), bytes([VIDEO] * 2), bytes([VIDEO_CONTROL, VIDEO_STREAMING]), bytes(2)]
        self._send(INTERFACES, 0, struct.pack("<I", 2) + b"".join(part.ljust(32, b"\0") for part in classes))
        types = [CONTROL_TYPE, *[NONE_TYPE] * 15, CONTROL_TYPE, BULK_TYPE, *[NONE_TYPE] * 14]
        owners = [*[0] * 17, 1, *[0] * 14]
        sizes = struct.pack("<32H", *[64, *[0] * 15, 64, 512, *[0] * 14])
        self._send(ENDPOINTS, 0, bytes(types) + bytes(32) + bytes(owners) + sizes)
        self._send(CONNECT, 0, struct.pack("<BBBBHH", HIGH_SPEED, 0xEF, 2, 1, 0x1D6B, 0x0102))

    def _answer(self, kind: int, number: int, body: bytes) -> None:
        if kind in (SET_CONFIGURATION, GET_CONFIGURATION):
            self._send(CONFIGURATION, number, bytes([SUCCESS, 1]))
        elif kind in (SET_ALTERNATIVE, GET_ALTERNATIVE):
            self._send(ALTERNATIVE, number, bytes([SUCCESS, body[0], 0]))
        elif kind == CONTROL:
            endpoint, request, request_type, _, value, index, length = _REQUEST.unpack_from(body)
            said = _told(request, request_type, value)
            status = STALL if said is None else SUCCESS
            said = (said or b"")[:length]
            taken = len(said) if request_type & 0x80 else length
            head = _REQUEST.pack(endpoint, request, request_type, status, value, index, taken)
            self._send(CONTROL, number, head + said)
        elif kind == BULK:
            endpoint, _, low, stream, high = _TRANSFER.unpack_from(body)
            part = self._next_part(high << 16 | low)
            self._send(BULK, number, _TRANSFER.pack(endpoint, SUCCESS, len(part), stream, 0) + part)

    def _next_part(self, most: int) -> bytes:
        """Return what comes next of the pictures, each of which ends with a transfer that is not full."""
        if not self._left:
            self._left = _payload(self._sent)
            self._sent += 1
        part, self._left = self._left[:most], self._left[most:]
        return part

    def _send(self, kind: int, number: int, body: bytes) -> None:
        self._line.sendall(_HEADER.pack(kind, len(body), number) + body)


def _told(request: int, request_type: int, value: int) -> bytes | None:
    """Return the answer to a control request, which is empty for what is set, or None for what the camera lacks."""
    if not request_type & 0x80:
        return b""
    if request_type == 0x80 and request == 6:
        descriptors = {
            0x0100: _device(),
            0x0200: _configuration(),
            0x0300: _described(3, struct.pack("<H", 0x0409)),
            0x0301: _described(3, NAME.encode("utf-16-le")),
        }
        return descriptors.get(value)
    if request_type == 0xA1 and value >> 8 in (1, 2):  # to be probed, or committed to
        return bytes([3]) if request == 0x86 else _probe()
    return bytes(2) if request_type == 0x80 and request == 0 else None
