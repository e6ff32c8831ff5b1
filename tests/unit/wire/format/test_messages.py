from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, Literal

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.device.data import DataType, EALData, Payload
from eal_actors.kernel import errors
from eal_actors.kernel.errors import (
    ConfigError,
    DataError,
    DeadlineError,
    EALError,
    Problem,
    ProtocolError,
    UnavailableError,
)
from eal_actors.wire.format import messages as wire
from eal_actors.wire.format.messages import ACCEPTED, CallHeader, CallId, CallReply, Heartbeat, RobotEvent, RobotTime
from eal_actors.wire.format.packing import MAX_CALL_BYTES, MAX_PAYLOAD_BYTES, PROTOCOL_VERSION, Buffer
from eal_actors.wire.shared_memory import SharedValue

CLIENT = 2 * "0123456789abcdef"
CALL = CallHeader(CLIENT, 3, 17, 0.5, 2.0, None, ("r45",))
TRACEPARENT = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"
ERRORS = [member for member in vars(errors).values() if isinstance(member, type) and issubclass(member, EALError)]


def raw(hexadecimal: str, **texts: str) -> bytes:
    """Return bytes written in hexadecimal, with `{name}` for the UTF-8 bytes of a text."""
    return bytes.fromhex(hexadecimal.format(**{name: text.encode().hex() for name, text in texts.items()}))


def encode_answer(answer: wire.Answer) -> tuple[bytes, Payload]:
    """Return an answer to call 7 as bytes."""
    return wire.encode_reply(CallReply(7, answer))


def decode_answer(envelope: Buffer, payload: Buffer = b"") -> wire.Answer:
    """Return what is answered to call 7."""
    sequence, answer, time = wire.decode_reply(envelope, payload)
    assert (sequence, time) == (7, None)
    return answer


# Expected bytes: written by hand after the tables of docs/reference/wire-format.md and the msgpack specification.


@pytest.mark.parametrize(
    ("header", "data", "envelope", "payload"),
    [
        pytest.param(
            CALL,
            None,
            "99 04 c4100123456789abcdef0123456789abcdef 03 11 cb3fe0000000000000 cb4000000000000000 c0 91a3723435 c0",
            "",
            id="send_cmd r45",
        ),
        pytest.param(
            CallHeader("ff" * 16, 0, 300, 2.0, 2.0, 12.0),
            EALData.of(1.5, unit="m", stamp_s=12.5),
            "99 04 c410ffffffffffffffffffffffffffffffff 00 cd012c cb4000000000000000 cb4000000000000000 "
            "cb4028000000000000 90 95 a6646f75626c65 c0 a16d c0 cb4029000000000000",
            "000000000000f83f",
            id="set_value 1.5 m at 12 s",
        ),
        pytest.param(
            CallHeader("ff" * 16, 0, 1, 1.0, 2.0, None, (), "ab", 0.5, 0.25),
            None,
            "9c 04 c410ffffffffffffffffffffffffffffffff 00 01 cb3ff0000000000000 cb4000000000000000 c0 90 c0"
            "a26162 cb3fe0000000000000 cb3fd0000000000000",
            "",
            id="with an echo",
        ),
        pytest.param(
            CALL._replace(traceparent=TRACEPARENT),
            None,
            "9e 04 c4100123456789abcdef0123456789abcdef 03 11 cb3fe0000000000000 cb4000000000000000 c0 91a3723435 c0"
            f"a0 cb0000000000000000 cb0000000000000000 c2 d937 {TRACEPARENT.encode().hex()}",
            "",
            id="a part of a trace",
        ),
    ],
)
def test_a_call_as_bytes(header: CallHeader, data: EALData | None, envelope: str, payload: str) -> None:
    assert wire.encode_call(header, data) == (bytes.fromhex(envelope), bytes.fromhex(payload))
    assert wire.decode_call(bytes.fromhex(envelope), bytes.fromhex(payload)) == (header, data)


@pytest.mark.parametrize(
    ("answer", "envelope", "payload"),
    [
        pytest.param(-1, raw("94 04 07 00 ff"), "", id="status"),
        pytest.param(
            EALData.of(np.array([[1, 2, 3], [4, 5, 6]], "u1"), frame_id="cam"),
            raw("94 04 07 01 95 af{type} 920203 c0 a3{frame} c0", type="unsigned char[]", frame="cam"),
            "010203040506",
            id="image",
        ),
        pytest.param({"state": "up"}, raw("94 04 07 03 81 a5{k} a2{v}", k="state", v="up"), "", id="fields"),
        pytest.param(ACCEPTED, raw("94 04 07 04 c0"), "", id="accepted"),
    ],
)
def test_an_answer_as_bytes(answer: wire.Answer, envelope: bytes, payload: str) -> None:
    packed, carried = encode_answer(answer)
    assert (packed, bytes(carried)) == (envelope, bytes.fromhex(payload))
    assert decode_answer(envelope, bytes.fromhex(payload)) == answer


def test_an_answer_with_the_robots_clock_as_bytes() -> None:
    reply = CallReply(300, 1, RobotTime("ab", 0.5, 0.25))
    envelope = bytes.fromhex("97 04 cd012c 00 01 a26162 cb3fe0000000000000 cb3fd0000000000000")
    assert wire.encode_reply(reply) == (envelope, b"")
    assert wire.decode_reply(envelope) == reply


def test_an_answer_in_shared_memory_as_bytes() -> None:
    data, place = EALData.of(1.5), SharedValue(300, 2, 9, 8)
    packed = raw("98 04 07 01 95 a6646f75626c65 c0 c0 c0 c0 c0 c0 c0 94 cd012c 02 09 08")
    assert wire.encode_reply(CallReply(7, data), place) == (packed, b"")
    assert wire.decode_reply(packed, b"", lambda it: bytes(data.payload) if it == place else b"") == (7, data, None)
    with pytest.raises(ProtocolError):
        wire.decode_reply(packed, b"")  # nobody who can take it
    with pytest.raises(ProtocolError):
        wire.decode_reply(packed[:-1] + b"\xff", b"", lambda _: bytes(data.payload))

    def lose(_: SharedValue) -> bytes:
        raise UnavailableError("gone")

    assert str(wire.decode_reply(packed, b"", lose).answer) == "gone"


def test_true_is_a_status() -> None:
    assert encode_answer(True) == (bytes.fromhex("9404070001"), b"")


def test_an_error_as_bytes() -> None:
    envelope = raw("94 04 07 02 94 a8{c} a7{m} a2{r} a5{s}", c="deadline", m="no echo", r="r1", s="Sonar")
    assert encode_answer(DeadlineError("no echo", robot="r1", resource="Sonar")) == (envelope, b"")
    back = decode_answer(envelope)
    assert type(back) is DeadlineError
    assert str(back) == "r1/Sonar: no echo"


def test_an_event_as_bytes() -> None:
    event = RobotEvent("result", 12.5, CallId(CLIENT, 3, 17), 1)
    envelope = raw(
        "85 a7{version} 04 a4{kind} a6{result} a7{stamp_s} cb4029000000000000"
        "a4{call} 93c4100123456789abcdef0123456789abcdef0311 a6{answer} 920001",
        **{name: name for name in ("version", "kind", "result", "stamp_s", "call", "answer")},
    )
    assert wire.encode_event(event) == (envelope, b"")
    assert wire.decode_event(envelope) == event


def test_a_heartbeat_as_bytes() -> None:
    beat = Heartbeat(CLIENT, "anna")
    envelope = raw(
        "83 a7{version} 04 a6{client} c4100123456789abcdef0123456789abcdef a4{name} a4{anna}",
        **{name: name for name in ("version", "client", "name", "anna")},
    )
    assert wire.encode_heartbeat(beat) == envelope
    assert wire.decode_heartbeat(envelope) == beat


# Round trips.

TEXT = st.text(st.characters(codec="utf-8", exclude_characters="\0"))
SHAPES = st.lists(st.integers(0, 4), max_size=4).map(tuple)


def whole(kind: DataType, bits: int, signed: bool, **flags: Any) -> list[st.SearchStrategy[EALData]]:
    low, high = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
    numbers, modifiers = st.integers(low, high), flags | {"is_unsigned": not signed}
    return [
        numbers.map(lambda value: EALData(kind, value, **modifiers)),
        st.lists(numbers).map(lambda values: EALData(kind, values, is_ptr=True, **modifiers)),
    ]


def real(kind: DataType, width: Literal[32, 64]) -> list[st.SearchStrategy[EALData]]:
    numbers = st.floats(width=width)
    return [
        numbers.map(lambda value: EALData(kind, value)),
        st.lists(numbers).map(lambda values: EALData(kind, values, is_ptr=True)),
    ]


@st.composite
def arrays(draw: st.DrawFn) -> EALData:
    dtype = np.dtype(draw(st.sampled_from(["<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "|u1", "<f4", "<f8", "|b1"])))
    shape = draw(SHAPES)
    fill = draw(st.integers(0, 1))
    return EALData.of(np.full(shape, fill, dtype))


EVERY_FORM = [
    *whole(DataType.INT, 32, True),
    *whole(DataType.INT, 32, False),
    *whole(DataType.INT, 16, True, is_short=True),
    *whole(DataType.INT, 16, False, is_short=True),
    *whole(DataType.INT, 64, True, is_long=True),
    *whole(DataType.INT, 64, False, is_long=True),
    *whole(DataType.CHAR, 8, False),
    *real(DataType.FLOAT, 32),
    *real(DataType.DOUBLE, 64),
    st.integers(0, 127).map(lambda code: EALData(DataType.CHAR, chr(code))),
    TEXT.map(lambda text: EALData(DataType.CHAR, text, is_ptr=True)),
    TEXT.map(lambda text: EALData(DataType.CHAR, text, len(text.encode()) + 3, is_ptr=True)),
    st.booleans().map(lambda value: EALData(DataType.BOOL, value)),
    st.lists(st.booleans()).map(lambda values: EALData(DataType.BOOL, values, is_ptr=True)),
    st.just(EALData(DataType.VOID)),
    st.binary().map(lambda value: EALData(DataType.VOID, value, is_ptr=True)),
    arrays(),
]


@st.composite
def values(draw: st.DrawFn) -> EALData:
    meta: dict[str, Any] = {
        "unit": draw(st.none() | TEXT),
        "frame_id": draw(st.none() | TEXT),
        "stamp_s": draw(st.none() | st.floats(allow_nan=False, allow_infinity=False)),
    }
    return draw(st.one_of(EVERY_FORM)).with_meta(**meta)


COUNTS = st.integers(0, 2**64 - 1)
CLIENTS = st.binary(min_size=16, max_size=16).map(bytes.hex)
SECONDS = st.floats(allow_nan=False)
TIMES = st.floats(allow_nan=False, allow_infinity=False)
PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | TIMES | TEXT | st.binary(),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXT, inner, max_size=4),
    max_leaves=10,
)
FIELDS = st.dictionaries(TEXT, PLAIN, max_size=4)
HEADERS = st.builds(
    CallHeader,
    CLIENTS,
    COUNTS,
    COUNTS,
    SECONDS,
    SECONDS,
    st.none() | TIMES,
    st.lists(TEXT | st.integers(-(2**63), 2**64 - 1), max_size=4).map(tuple),
    TEXT,
    TIMES,
    TIMES,
)
ANSWERS = st.integers(-(2**63), 2**63 - 1) | values() | FIELDS | st.just(ACCEPTED)
EVENTS = st.builds(
    RobotEvent, TEXT, TIMES, st.none() | st.builds(CallId, CLIENTS, COUNTS, COUNTS), st.none() | ANSWERS, FIELDS
)
BUFFERS = st.sampled_from([bytes, bytearray, memoryview])


@pytest.mark.parametrize("form", EVERY_FORM)
@given(data=st.data())
def test_every_form_of_a_value_arrives_as_it_left(form: st.SearchStrategy[EALData], data: st.DataObject) -> None:
    sent = data.draw(form)
    envelope, payload = encode_answer(sent)
    assert decode_answer(envelope, bytes(payload)) == sent


@given(HEADERS, st.none() | values(), BUFFERS)
def test_every_call_arrives_as_it_left(header: CallHeader, data: EALData | None, buffer: Callable[..., Any]) -> None:
    envelope, payload = wire.encode_call(header, data)
    assert wire.decode_call(buffer(envelope), buffer(payload)) == (header, data)


@given(ANSWERS, BUFFERS)
def test_every_answer_arrives_as_it_left(answer: wire.Answer, buffer: Callable[..., Any]) -> None:
    envelope, payload = encode_answer(answer)
    assert decode_answer(buffer(envelope), buffer(payload)) == answer


@given(EVENTS)
def test_every_event_arrives_as_it_left(event: RobotEvent) -> None:
    assert wire.decode_event(*wire.encode_event(event)) == event


@pytest.mark.parametrize("kind", [kind for kind in ERRORS if kind is not ConfigError])
def test_every_error_arrives_as_it_left(kind: type[EALError]) -> None:
    back = decode_answer(*encode_answer(kind("what and where", robot="r1", resource="Sonar")))
    assert type(back) is kind
    assert (back.message, back.robot, back.resource) == ("what and where", "r1", "Sonar")
    assert str(back) == "r1/Sonar: what and where"


def test_every_error_has_its_own_code() -> None:
    assert len({kind.code for kind in ERRORS}) == len(ERRORS) > 25


def test_a_config_error_arrives_as_its_message() -> None:
    sent = ConfigError([Problem("lab.yaml", 3, 5, "robots.r1", "is missing")])
    back = decode_answer(*encode_answer(sent))
    assert type(back) is ConfigError
    assert str(back) == "lab.yaml:3:5: robots.r1: is missing"
    assert back.problems == ()


def test_an_error_of_an_unknown_kind_keeps_its_code_in_the_message() -> None:
    envelope = msgpack.packb([PROTOCOL_VERSION, 7, 2, ["too_hot", "60 °C", "r1", None]])
    back = decode_answer(envelope)
    assert type(back) is EALError
    assert str(back) == "r1: 60 °C (an error of a kind unknown here: 'too_hot')"


def test_an_error_can_always_be_sent() -> None:
    back = decode_answer(*encode_answer(EALError("\udcff" + "x" * 2_000_000, robot="\ud800")))
    assert isinstance(back, EALError)
    assert back.message.startswith("\\udcffxxx")
    assert len(back.message) < 20_000
    assert back.robot == "\\ud800"


# The payload.


def test_a_frame_is_not_copied() -> None:
    frame = np.zeros((480, 640, 3), "u1")
    envelope, payload = encode_answer(EALData.of(frame))
    assert np.shares_memory(np.frombuffer(payload, "u1"), frame)
    assert len(envelope) < 40
    arrived = bytes(payload)
    back = decode_answer(envelope, arrived)
    assert isinstance(back, EALData)
    assert np.shares_memory(np.frombuffer(arrived, "u1"), back.value)


def test_a_call_has_at_most_8_mib_and_an_answer_64() -> None:
    envelope, payload = wire.encode_call(CALL, EALData.of(np.zeros(MAX_CALL_BYTES, "u1")))
    assert wire.decode_call(envelope, payload)[1] is not None
    with pytest.raises(DataError, match="8388609 bytes is over the 8388608"):
        wire.encode_call(CALL, EALData.of(np.zeros(MAX_CALL_BYTES + 1, "u1")))
    too_much = EALData.of(np.zeros(MAX_PAYLOAD_BYTES + 1, "u1"))
    with pytest.raises(DataError, match="67108865 bytes is over the 67108864"):
        encode_answer(too_much)
    with pytest.raises(ProtocolError, match="a payload of 67108865 bytes, more than 67108864"):
        decode_answer(encode_answer(EALData.of(1.0))[0], too_much.payload)


def test_text_that_is_no_unicode_is_sent_in_escapes() -> None:
    header, _ = wire.decode_call(*wire.encode_call(CALL._replace(arguments=("caf\udce9",))))
    assert header.arguments == ("caf\\udce9",)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (CALL._replace(client="evbot"), "client 'evbot' is not 32 hexadecimal digits"),
        (CALL._replace(sequence=2**64), "call cannot be sent"),
        (CALL._replace(arguments=(2**70,)), "call cannot be sent"),
        (CALL._replace(arguments=("x" * 2**20,)), "more than 1048576"),
    ],
)
def test_what_cannot_be_sent_is_refused_at_once(header: CallHeader, message: str) -> None:
    with pytest.raises(DataError, match=re.escape(message)):
        wire.encode_call(header)
