"""Parts of envelopes: strict msgpack, the type header of a value, errors by their code, and checks of fields.

Every function that decodes returns a valid object or raises ProtocolError, whatever bytes arrive. Its `what` argument
names the message that is decoded, for error messages.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final

import msgpack

from eal_actors.device.data import EALData, Payload
from eal_actors.device.data.c_types import C_TYPES, short_repr
from eal_actors.device.data.storage import as_bytes
from eal_actors.kernel import errors
from eal_actors.kernel.errors import ConfigError, DataError, EALError, ProtocolError
from eal_actors.wire.shared_memory import SharedValue

PROTOCOL_VERSION: Final = 4
"""Incremented when an older reader would misunderstand a message; see docs/reference/wire-format.md."""
MAX_ENVELOPE_BYTES: Final = 1024**2
MAX_PAYLOAD_BYTES: Final = 64 * 1024**2
MAX_CALL_BYTES: Final = 8 * 1024**2
"""Limit of the payload of a call. Robots have little memory, and each connected program may send to them."""
MAX_ITEMS: Final = 4096
"""Limit of one list or map in an envelope, so that nested ones cannot make a reader allocate much memory."""
MAX_WORD: Final = 256
MAX_MESSAGE_CHARS: Final = 16_000
"""Longer error messages are truncated."""

CLIENT_BYTES: Final = 16

Buffer = bytes | bytearray | memoryview

_pack: Final = msgpack.Packer(unicode_errors="backslashreplace").pack
"""Packs any text, such as a user's name or a device's message that is no UTF-8: an unsendable one would end the thread
that sends. `packb` makes a new packer for each message, which takes twice as long as packing."""

_FORM_BY_C_NAME: Final = {form.full_name: form for form in C_TYPES.values()}
_ERROR_BY_CODE: Final[dict[str, type[EALError]]] = {
    member.code: member for member in vars(errors).values() if isinstance(member, type) and issubclass(member, EALError)
}


def pack(fields: object, what: str) -> bytes:
    """Return the msgpack bytes of lists, tuples, dicts with str keys, str, bytes, int, float, bool and None.

    Raises DataError if a value has no msgpack form, or the envelope is larger than MAX_ENVELOPE_BYTES.
    """
    try:
        packed: bytes = _pack(fields)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{what} cannot be sent: {error}") from error
    if len(packed) > MAX_ENVELOPE_BYTES:
        raise DataError(f"{what} takes {len(packed)} bytes beside its payload, more than {MAX_ENVELOPE_BYTES}")
    return packed


def unpack_row(packed: Buffer, what: str, size: int) -> list[Any]:
    """Return the first `size` fields of an envelope that is a list; ProtocolError if it is none of this version."""
    return optional_row(unpack(packed, what), what, size, 0)


def optional_row(row: object, what: str, size: int, optional: int) -> list[Any]:
    """Return the first `size` fields of an unpacked list, then `optional` further ones or None; raises the same."""
    if type(row) is not list or not row:
        raise ProtocolError(f"{what}: the envelope is {short_repr(row)}, not a list that begins with the version")
    check_version(row[0], what)
    missing = size + optional - len(row)
    if 0 < missing <= optional:
        row = [*row, *[None] * missing]
    return checked_row(row, what, size + optional)


def unpack_map(packed: Buffer, what: str) -> dict[str, Any]:
    """Return the fields of an envelope that is a map; ProtocolError if it is none of this version."""
    fields = unpack(packed, what)
    if type(fields) is not dict:
        raise ProtocolError(f"{what}: the envelope is {short_repr(fields)}, not a map")
    check_version(fields.get("version"), what)
    return fields


def check_version(version: object, what: str) -> None:
    """Raise ProtocolError with both versions unless the peer uses this version of the protocol."""
    if version != PROTOCOL_VERSION or type(version) is not int:
        raise ProtocolError(
            f"{what}: the other end speaks version {short_repr(version)} of the protocol, this one {PROTOCOL_VERSION}; "
            "install the same release of eal-actors at both ends"
        )


def unpack(packed: Buffer, what: str) -> Any:
    """Return the content of an envelope; ProtocolError if it is too large or no msgpack."""
    size = packed.nbytes if type(packed) is memoryview else len(packed)
    if size > MAX_ENVELOPE_BYTES:
        raise ProtocolError(f"{what}: an envelope of {size} bytes, more than {MAX_ENVELOPE_BYTES}")
    try:
        return msgpack.unpackb(
            packed, object_pairs_hook=_text_keys, max_array_len=MAX_ITEMS, max_map_len=MAX_ITEMS, max_ext_len=0
        )
    except (ValueError, TypeError, BufferError, msgpack.UnpackException) as error:
        raise ProtocolError(f"{what}: no valid msgpack: {short_repr(str(error) or type(error).__name__)}") from error


def _text_keys(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs) or any(type(key) is not str for key in fields):
        raise ValueError("a map has a duplicate key, or one that is no text")
    return fields


# Values.


def data_header(data: EALData) -> tuple[Any, ...]:
    """Return the type header of a value: C type, shape, unit, frame and time."""
    c_type, _, shape, unit, frame_id, stamp_s = data.description
    return c_type.full_name, shape, unit, frame_id, stamp_s


def data_from(header: object, payload: Buffer, what: str) -> EALData:
    """Rebuild a value, whose payload is not copied and must not change; ProtocolError if the header does not fit it."""
    if type(header) is not list or len(header) != 5:
        header = checked_row(header, what, 5)
    name, shape, unit, frame_id, stamp_s = header
    form = _FORM_BY_C_NAME.get(name) if type(name) is str else None
    if form is None:
        raise ProtocolError(f"{what}: there is no type {short_repr(name)}, only {', '.join(_FORM_BY_C_NAME)}")
    try:
        return EALData.from_c_type(
            form, payload, shape, None if shape is None else form.dtype, unit=unit, frame_id=frame_id, stamp_s=stamp_s
        )
    except DataError as error:
        raise ProtocolError(f"{what}: {error.message}") from error


def optional_data_from(header: object, payload: Buffer, what: str) -> EALData | None:
    """Rebuild a value; None for a message without header and payload, ProtocolError if they are invalid."""
    if header is not None:
        return data_from(header, checked_payload(payload, what), what)
    if len(checked_payload(payload, what)):
        raise ProtocolError(f"{what}: a payload without a type")
    return None


def shared_from(row: object, what: str) -> SharedValue:
    """Return the place of a value in shared memory; ProtocolError if the row is none."""
    return SharedValue(*(checked_count(field, f"{what}: shared memory:") for field in checked_row(row, what, 4)))


def payload_of(data: EALData, most: int = MAX_PAYLOAD_BYTES) -> Payload:
    """Return the payload of a value; DataError if it has more than `most` bytes."""
    if data.length > most:
        raise DataError(f"a value of {data.length} bytes is over the {most} that one message may carry")
    return data.payload


# Errors.


def error_body(error: EALError) -> tuple[str | None, ...]:
    """Return an error's code, message, robot and resource in a form that can always be sent."""
    return error.code, _sendable(error.message), _sendable(error.robot), _sendable(error.resource)


def error_from(body: object, what: str) -> EALError:
    """Rebuild an error, an EALError with the code in its message if that is unknown; ProtocolError if it is none."""
    code, message, robot, resource = checked_row(body, what, 4)
    names = (robot, resource)
    if type(code) is not str or type(message) is not str or any(type(n) not in (str, type(None)) for n in names):
        raise ProtocolError(f"{what}: {short_repr(body)} is not an error's code, message, robot and resource")
    kind = _ERROR_BY_CODE.get(code)
    if kind is None:
        return EALError(f"{message} (an error of a kind unknown here: {code!r})", robot=robot, resource=resource)
    if kind is not ConfigError:
        return kind(message, robot=robot, resource=resource)
    error = ConfigError(())  # positions in a file of the other machine mean nothing here
    error.message = message
    error.args = (message,)
    return error.at(robot, resource)


def _sendable(text: str | None) -> str | None:
    if text is None:
        return None
    return str(text)[:MAX_MESSAGE_CHARS].encode("utf-8", "backslashreplace").decode()


# Checks of single fields; each raises ProtocolError.


def checked_row(row: object, what: str, size: int) -> list[Any]:
    """Return the first `size` fields of a list; later versions may append more."""
    if type(row) is not list or len(row) < size:
        raise ProtocolError(f"{what}: {short_repr(row)} is not a list of at least {size} fields")
    return row if len(row) == size else row[:size]


def checked_payload(payload: Buffer, what: str) -> Payload:
    """Return a payload as bytes of at most MAX_PAYLOAD_BYTES."""
    try:
        view = payload if type(payload) is bytes else as_bytes(payload)
    except DataError as error:
        raise ProtocolError(f"{what}: {error.message}") from error
    if len(view) > MAX_PAYLOAD_BYTES:
        raise ProtocolError(f"{what}: a payload of {len(view)} bytes, more than {MAX_PAYLOAD_BYTES}")
    return view


@lru_cache(maxsize=4096)
def packed_client(client: str) -> bytes:
    """Return the bytes of a client id; DataError unless it is 32 hexadecimal digits."""
    try:
        packed = bytes.fromhex(client)
    except (ValueError, TypeError):
        packed = b""
    if len(packed) != CLIENT_BYTES:
        raise DataError(f"client {short_repr(client)} is not {2 * CLIENT_BYTES} hexadecimal digits")
    return packed


def checked_client(client: object, what: str) -> str:
    """Return a client id as hexadecimal digits."""
    if type(client) is not bytes or len(client) != CLIENT_BYTES:
        raise ProtocolError(f"{what}: client {short_repr(client)} is not {CLIENT_BYTES} bytes")
    return hexadecimal(client)


hexadecimal: Final = lru_cache(maxsize=4096)(bytes.hex)


def checked_count(count: object, what: str) -> int:
    """Return an int from 0."""
    if type(count) is not int or count < 0:
        raise ProtocolError(f"{what} {short_repr(count)} is not an int from 0")
    return count


def checked_seconds(seconds: object, what: str) -> float:
    """Return a number of seconds, which may be infinite."""
    if type(seconds) not in (float, int) or seconds != seconds:
        raise ProtocolError(f"{what} {short_repr(seconds)} is no number of seconds")
    return float(seconds)  # type: ignore[arg-type]  # mypy does not follow `type(x) in`


def checked_time(seconds: object, what: str) -> float:
    """Return a finite number of seconds."""
    time_s = checked_seconds(seconds, what)
    if not math.isfinite(time_s):
        raise ProtocolError(f"{what} {time_s} is no time")
    return time_s


def checked_text(text: object, what: str) -> str:
    """Return a str."""
    if type(text) is not str:
        raise ProtocolError(f"{what} {short_repr(text)} is no text")
    return text


def checked_word(word: object, what: str) -> str:
    """Return a short text, which may be kept as long as its call waits."""
    text = checked_text(word, what)
    if len(text) > MAX_WORD:
        raise ProtocolError(f"{what}: {len(text)} characters, more than {MAX_WORD}")
    return text
