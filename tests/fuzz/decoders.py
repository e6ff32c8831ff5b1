"""Fuzz targets of the network and the robots' wires: each accepts any bytes and raises only for a finding.

A decoder of a stream must find the same in the same bytes, however they are cut into pieces.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from types import ModuleType
from typing import Any

from eal_actors.kernel.errors import DataError, ProtocolError
from eal_actors.wire.format import keys
from eal_actors.wire.format import messages as wire
from eal_actors.wire.format.frames import decode_frame
from plugins.camera.program import JpegSplitter
from plugins.evbot2 import protocol as evbot2_protocol
from plugins.evbot2.emulator import evbot2, free_vehicle
from plugins.evbot3 import protocol as evbot3_protocol
from plugins.evbot3.emulator import FreeTurretVehicle, evbot3
from plugins.roomba import groups, packets
from plugins.roomba.bodies import FreeRoombaBody
from plugins.roomba.oi_emulator import OiEmulator
from plugins.roomba.sci import WHEELBASE_M
from plugins.roomba.sci_emulator import SciEmulator
from plugins.roomba.tinyos import Header, TinyosFraming

Feed = Callable[[bytes], Any]
_TICK_S = 0.01


def _parted(data: bytes) -> tuple[bytes, bytes]:
    """Cut bytes into an envelope and a payload: the first byte says how long the payload is."""
    content = data[1:]
    place = len(content) - (data[0] if data else 0)
    return content[: max(0, place)], content[max(0, place) :]


def _pieces(data: bytes) -> list[bytes]:
    """Cut bytes into pieces: the first byte says how long they are."""
    size, content = (data[0] % 7 + 1, data[1:]) if data else (1, b"")
    return [content[at : at + size] for at in range(0, len(content), size)]


def _call(data: bytes) -> None:
    with suppress(ProtocolError):
        header, value = wire.decode_call(*_parted(data))
        if wire.decode_call(*wire.encode_call(header, value)) != (header, value):
            raise AssertionError("a call is not what it was")


def _answer(data: bytes) -> None:
    with suppress(ProtocolError):
        sent = wire.encode_reply(wire.decode_reply(*_parted(data)))
        if wire.encode_reply(wire.decode_reply(*sent)) != sent:
            raise AssertionError("an answer is not what it was")


def _event(data: bytes) -> None:
    with suppress(ProtocolError):
        sent = wire.encode_event(wire.decode_event(*_parted(data)))
        if wire.encode_event(wire.decode_event(*sent)) != sent:
            raise AssertionError("an event is not what it was")


def _heartbeat(data: bytes) -> None:
    with suppress(ProtocolError):
        beat = wire.decode_heartbeat(data)
        if wire.decode_heartbeat(wire.encode_heartbeat(beat)) != beat:
            raise AssertionError("a heartbeat is not what it was")


def _frame(data: bytes) -> None:
    with suppress(ProtocolError):
        decode_frame(*_parted(data))


def _key(data: bytes) -> None:
    with suppress(ProtocolError):
        key = data.decode("utf-8", "replace")
        if keys.call_key(keys.parse_route(key).call) != key:
            raise AssertionError("a key is not what it was")


def _sci_group(data: bytes) -> None:
    group, content = (data[0] % 4, data[1:]) if data else (0, b"")
    with suppress(DataError):
        kind = (groups.Sensors, groups.Contacts, groups.Controls, groups.PowerGroup)[group]
        if kind.decode(content).encode() != content:
            raise AssertionError("a sensor group is not what it was")


def _oi_packets(data: bytes) -> None:
    number, content = (data[0], data[1:]) if data else (0, b"")
    with suppress(DataError):
        values = packets.decode(packets.packets_of(number), content)
        if b"".join(packets.encode(*entry) for entry in values.items()) != content:
            raise AssertionError("packets are not what they were")


def _same_in_pieces(data: bytes, make: Callable[[], Feed]) -> Any:
    """Feed a stream's decoder at once and piece by piece; return what it finds."""
    at_once, in_pieces = make(), make()
    whole = at_once(data[1:])
    parts = [found for piece in _pieces(data) for found in in_pieces(piece)]
    if list(whole) != parts:
        raise AssertionError(f"{whole} at once, but {parts} in pieces")
    return whole


def _oi_stream(data: bytes) -> None:
    for values in _same_in_pieces(data, lambda: packets.StreamReader().feed):
        packets.stream_frame(values)


def _evbot2(data: bytes) -> None:
    _evbot_codecs(data, evbot2_protocol)
    _obeys(data, lambda: evbot2(free_vehicle(lambda: 0.0), _TICK_S).feed)


def _evbot3(data: bytes) -> None:
    _evbot_codecs(data, evbot3_protocol)
    _obeys(data, lambda: evbot3(FreeTurretVehicle(lambda: 0.0), _TICK_S).feed)


def _evbot_codecs(data: bytes, protocol: ModuleType) -> None:
    _same_in_pieces(data, lambda: protocol.base_codec().feed)
    for reply in _same_in_pieces(data, lambda: protocol.host_codec().feed):
        if protocol.host_codec().feed(protocol.encode_reply(reply)) != [reply]:
            raise AssertionError(f"{reply} is not what it was")


def _sci_emulator(data: bytes) -> None:
    _obeys(data, lambda: SciEmulator(FreeRoombaBody(lambda: 0.0, WHEELBASE_M), mode_pause_s=0.0).feed)


def _oi_emulator(data: bytes) -> None:
    roomba = OiEmulator(FreeRoombaBody(lambda: 0.0, WHEELBASE_M), mode_pause_s=0.0)
    for number, piece in enumerate(_pieces(data)):  # its stream goes on with the time, so that the pieces matter
        roomba.feed(piece, number / 100)


def _obeys(data: bytes, make: Callable[[], Callable[[bytes, float], bytes]]) -> None:
    """Feed an emulated robot, of whose time nothing passes."""

    def fed() -> Feed:
        feed = make()
        return lambda piece: feed(piece, 0.0)

    _same_in_pieces(data, fed)


_FRAMINGS = (
    TinyosFraming(),
    TinyosFraming(Header.TINYOS_1),
    TinyosFraming(ack_byte=1, reliable_byte=0x7E, plain_byte=0x7D, am_type=6),
)


def _tinyos(data: bytes) -> None:
    for framing in _FRAMINGS:
        for body in _same_in_pieces(data, lambda framing=framing: framing.deframer().feed):  # type: ignore[misc]
            with suppress(DataError):
                framing.read(body)


def _jpeg_stream(data: bytes) -> None:
    def split(pieces: list[bytes]) -> list[bytes] | None:
        splitter = JpegSplitter()
        try:
            return [file for piece in pieces for file in splitter.feed(piece)]
        except OSError:
            return None

    if split(_pieces(data)) != split([data[1:]]):
        raise AssertionError("pictures depend on how the stream is cut")


DECODERS: dict[str, Callable[[bytes], None]] = {
    "wire-call": _call,
    "wire-answer": _answer,
    "wire-event": _event,
    "wire-heartbeat": _heartbeat,
    "wire-frame": _frame,
    "wire-key": _key,
    "sci-group": _sci_group,
    "sci-emulator": _sci_emulator,
    "oi-packets": _oi_packets,
    "oi-stream": _oi_stream,
    "oi-emulator": _oi_emulator,
    "tinyos": _tinyos,
    "evbot2": _evbot2,
    "evbot3": _evbot3,
    "jpeg-stream": _jpeg_stream,
}
