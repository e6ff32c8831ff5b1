"""Envelopes of other versions, cut off, made up or forged."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.device.data import EALData, Payload
from eal_actors.kernel.errors import DeadlineError, ProtocolError
from eal_actors.wire.format import messages as wire
from eal_actors.wire.format.messages import CallHeader, CallId, Heartbeat, RobotEvent
from eal_actors.wire.format.packing import PROTOCOL_VERSION

CLIENT = 2 * "0123456789abcdef"
CALL = CallHeader(CLIENT, 3, 17, 0.5, 2.0, None, ("r45",), "8f3a", 5.0, 0.25)
DECODERS: dict[str, Callable[..., Any]] = {
    "call": wire.decode_call,
    "answer": wire.decode_reply,
    "event": wire.decode_event,
    "heartbeat": wire.decode_heartbeat,
}


def encode_answer(answer: wire.Answer) -> tuple[bytes, Payload]:
    return wire.encode_reply(wire.CallReply(9, answer))


# Other versions.


@pytest.mark.parametrize("version", [0, 1, PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1, None, True, "4"])
@pytest.mark.parametrize("name", DECODERS)
def test_another_version_is_named_with_ours(name: str, version: object) -> None:
    form = [version, "x"] if name in ("call", "answer") else {"version": version}
    with pytest.raises(
        ProtocolError, match=f"speaks version {version!r} of the protocol, this one {PROTOCOL_VERSION};"
    ):
        DECODERS[name](msgpack.packb(form))


def test_what_later_versions_add_is_passed_over() -> None:
    data = EALData.of(1.5)
    envelope, payload = wire.encode_call(CALL, data)
    row = msgpack.unpackb(envelope)
    row[8].append({"new": 1})
    assert wire.decode_call(msgpack.packb([*row, False, "", "new", 2]), payload) == (CALL, data)
    assert wire.decode_reply(msgpack.packb([PROTOCOL_VERSION, 9, 0, 5, "8f3a", 2.5, None, "new"])) == (
        9,
        5,
        wire.RobotTime("8f3a", 2.5),
    )
    beat, event = Heartbeat(CLIENT), RobotEvent("lost", 1.0)
    fields = msgpack.unpackb(wire.encode_heartbeat(beat)) | {"new": [1]}
    assert wire.decode_heartbeat(msgpack.packb(fields)) == beat
    fields = msgpack.unpackb(wire.encode_event(event)[0]) | {"new": [1]}
    assert wire.decode_event(msgpack.packb(fields)) == event


# What makes no sense.

GOOD: list[tuple[str, bytes]] = [
    ("call", wire.encode_call(CALL)[0]),
    ("answer", encode_answer(1)[0]),
    ("answer", encode_answer(DeadlineError("no echo", robot="r1"))[0]),
    ("answer", encode_answer({"a": [1, {"b": None}]})[0]),
    ("event", wire.encode_event(RobotEvent("result", 1.0, CallId(CLIENT, 1, 2), 1, {"a": 1}))[0]),
    ("heartbeat", wire.encode_heartbeat(Heartbeat(CLIENT, "anna"))),
]


@pytest.mark.parametrize(("name", "envelope"), GOOD)
def test_what_is_cut_off_is_refused(name: str, envelope: bytes) -> None:
    for length in range(len(envelope)):
        with pytest.raises(ProtocolError, match=f"^{name}: "):
            DECODERS[name](envelope[:length])
    with pytest.raises(ProtocolError, match="extra data"):
        DECODERS[name](envelope + b"\0")


def accepts_or_refuses(name: str, envelope: bytes, payload: bytes) -> None:
    """Check that bytes give a ProtocolError, or an object that can be sent again."""
    try:
        if name == "call":
            header, data = wire.decode_call(envelope, payload)
            assert wire.decode_call(*wire.encode_call(header, data)) == (header, data)
        elif name == "answer":
            sent = wire.encode_reply(wire.decode_reply(envelope, payload))
            assert wire.encode_reply(wire.decode_reply(*sent)) == sent
        elif name == "event":
            sent = wire.encode_event(wire.decode_event(envelope, payload))
            assert wire.encode_event(wire.decode_event(*sent)) == sent
        else:
            beat = wire.decode_heartbeat(envelope)
            assert wire.decode_heartbeat(wire.encode_heartbeat(beat)) == beat
    except ProtocolError:
        return


TEXT = st.text(st.characters(codec="utf-8"))
COUNTS = st.integers(0, 2**64 - 1)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | TEXT | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT | st.binary(), inner, max_size=4),
    max_leaves=10,
)
NAMES = st.sampled_from(list(DECODERS))
TYPE_NAMES = st.sampled_from(["int", "double[]", "char[]", "unsigned char[]", "char", "bool[]", "void", "void[]"])
LOOKS_LIKE_A_TYPE = st.tuples(TYPE_NAMES, st.lists(st.integers(-1, 2**40)) | st.none() | PLAIN, PLAIN, PLAIN, PLAIN)
LOOKS_LIKE_AN_ANSWER = st.tuples(st.integers(-1, 5) | PLAIN, LOOKS_LIKE_A_TYPE | PLAIN)
LOOKS_LIKE_A_CALL = st.tuples(
    st.just(PROTOCOL_VERSION),
    st.binary(min_size=16, max_size=16),
    *[st.integers(0, 9) | PLAIN] * 4,
    PLAIN,
    st.lists(st.integers(0, 9) | TEXT) | PLAIN,
    LOOKS_LIKE_A_TYPE | PLAIN,
)
LOOKS_LIKE_AN_EVENT = st.fixed_dictionaries(
    {"version": st.just(PROTOCOL_VERSION), "kind": TEXT | PLAIN, "stamp_s": st.floats() | PLAIN},
    optional={
        "call": st.tuples(st.binary(min_size=16, max_size=16), COUNTS, COUNTS) | PLAIN,
        "answer": LOOKS_LIKE_AN_ANSWER | PLAIN,
        "fields": PLAIN,
        "client": st.binary(min_size=16, max_size=16) | PLAIN,
        "epoch": COUNTS | PLAIN,
        "sequence": COUNTS | PLAIN,
        "name": TEXT | PLAIN,
    },
)


@given(NAMES, st.binary(), st.binary())
def test_any_bytes_are_refused_or_understood(name: str, envelope: bytes, payload: bytes) -> None:
    accepts_or_refuses(name, envelope, payload)


@given(
    NAMES,
    LOOKS_LIKE_A_CALL
    | st.tuples(st.just(PROTOCOL_VERSION), COUNTS, PLAIN, PLAIN)
    | LOOKS_LIKE_AN_EVENT
    | PLAIN
    | LOOKS_LIKE_AN_ANSWER.map(lambda answer: (PROTOCOL_VERSION, 9, *answer)),
    st.binary(max_size=16),
)
def test_any_msgpack_is_refused_or_understood(name: str, fields: object, payload: bytes) -> None:
    accepts_or_refuses(name, msgpack.packb(fields), payload)


@given(st.sampled_from(GOOD), st.data())
def test_a_flipped_byte_is_refused_or_understood(good: tuple[str, bytes], data: st.DataObject) -> None:
    name, envelope = good
    index = data.draw(st.integers(0, len(envelope) - 1))
    accepts_or_refuses(
        name, envelope[:index] + data.draw(st.binary(min_size=1, max_size=1)) + envelope[index + 1 :], b""
    )


def changed(**fields: object) -> bytes:
    names = (
        "version",
        "client",
        "epoch",
        "sequence",
        "ttl_s",
        "deadline_s",
        "start_s",
        "arguments",
        "data",
        "era",
        "echo_s",
        "held_s",
    )
    row = dict(zip(names, msgpack.unpackb(GOOD[0][1]), strict=True))
    return bytes(msgpack.packb(list((row | fields).values())))


def followed_by(hexadecimal: str) -> bytes:
    """Return a call with a fourteenth field."""
    return b"\x9e" + changed(has_more=True)[1:] + bytes.fromhex(hexadecimal)


@pytest.mark.parametrize(
    ("envelope", "message"),
    [
        pytest.param(changed(client=b"1234567"), "client b'1234567' is not 16 bytes", id="client too short"),
        pytest.param(changed(client=CLIENT), "is not 16 bytes", id="client as text"),
        pytest.param(changed(epoch=-1), "epoch -1 is not an int from 0", id="epoch below 0"),
        pytest.param(changed(sequence=True), "sequence True is not an int", id="sequence a bool"),
        pytest.param(changed(ttl_s=float("nan")), "ttl_s nan is no number of seconds", id="ttl not a number"),
        pytest.param(changed(deadline_s="2"), "deadline_s '2' is no number", id="deadline a text"),
        pytest.param(changed(start_s=float("inf")), "start_s inf is no time", id="start never"),
        pytest.param(changed(arguments=[1.5]), "arguments [1.5] are not a list of texts and ints", id="float argument"),
        pytest.param(changed(data=["quaternion", None, None, None, None]), "no type 'quaternion'", id="unknown type"),
        pytest.param(changed(data=["int", None, None, None, None]), "int takes 4 bytes, not 0", id="no payload"),
        pytest.param(changed(data=["int"]), "not a list of at least 5 fields", id="type header too short"),
        pytest.param(
            followed_by("d6ff00000000"),
            "max_ext_len",
            id="time stamp of msgpack",
        ),
        pytest.param(followed_by("d40500"), "max_ext_len", id="extension type"),
        pytest.param(followed_by("8101c0"), "map key", id="map with a number for a key"),
        pytest.param(followed_by("81c40161c0"), "no text", id="map with bytes for a key"),
        pytest.param(
            followed_by("82a161c0a161c0"),
            "a duplicate key",
            id="map with a key twice",
        ),
        pytest.param(bytes.fromhex("dd0000ffff") + bytes(0xFFFF), "max_array_len", id="too many items"),
        pytest.param(b"\x91" * 5000, "no valid msgpack", id="too deep"),
        pytest.param(bytes(2**20 + 1), "an envelope of 1048577 bytes, more than 1048576", id="too large"),
        pytest.param(bytes.fromhex("81a776657273696f6e02"), "not a list that begins with the version", id="a map"),
        pytest.param(memoryview(bytes(100))[::2], "call: no valid msgpack", id="with gaps"),
    ],
)
def test_what_a_call_may_not_hold(envelope: bytes, message: str) -> None:
    with pytest.raises(ProtocolError, match=re.escape(message)):
        wire.decode_call(envelope)


def test_a_payload_needs_a_type() -> None:
    for name, envelope in GOOD[:-1]:
        with pytest.raises(ProtocolError, match="a payload without a type"):
            DECODERS[name](envelope, struct.pack("<d", 1.0))
