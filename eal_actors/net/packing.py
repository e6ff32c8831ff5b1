"""The parts that envelopes are made of: strict msgpack, the type header of a value, and errors by their code."""

from __future__ import annotations

from typing import Any, Final

import msgpack

from eal_actors.device.data import EALData
from eal_actors.device.data.c_types import C_TYPES, CType, short_repr
from eal_actors.kernel import errors
from eal_actors.kernel.errors import ConfigError, DataError, EALError, ProtocolError

PROTOCOL_VERSION: Final = 2
"""Goes up when an older reader would misunderstand; see docs/network.md."""
MAX_ENVELOPE_BYTES: Final = 1024**2
MAX_ITEMS: Final = 4096
"""Of one list or map in an envelope: what is nested can then make no reader allocate much."""
MAX_MESSAGE_CHARS: Final = 16_000
"""What an error's message is cut to."""

Buffer = bytes | bytearray | memoryview

_C_NAMES: Final = {key: form.name + "[]" * form.is_ptr for key, form in C_TYPES.items()}
_C_TYPE_BY_NAME: Final[dict[str, CType]] = {_C_NAMES[key]: form for key, form in C_TYPES.items()}
_ERROR_BY_CODE: Final[dict[str, type[EALError]]] = {
    member.code: member for member in vars(errors).values() if isinstance(member, type) and issubclass(member, EALError)
}


def pack(fields: object, what: str) -> bytes:
    """Return the msgpack bytes of plain values.

    Args:
        fields: lists or tuples, dicts with str keys, str, bytes, int, float, bool and None.
        what: what they are, for messages.

    Raises:
        DataError: something in them has no msgpack form, or they are too large.
    """
    try:
        packed: bytes = msgpack.packb(fields)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(f"{what} cannot be sent: {error}") from error
    if len(packed) > MAX_ENVELOPE_BYTES:
        raise DataError(f"{what} takes {len(packed)} bytes beside its payload, more than {MAX_ENVELOPE_BYTES}")
    return packed


def unpack_row(packed: Buffer, what: str, size: int, optional: int = 0) -> list[Any]:
    """Return the first `size` fields, and `optional` further ones or None, of an envelope that is a list.

    Its first field is the version.

    Raises:
        ProtocolError: the bytes are no such envelope, or of another version.
    """
    row = _unpack(packed, what)
    if type(row) is not list or not row:
        raise ProtocolError(f"{what}: the envelope is {short_repr(row)}, not a list that begins with the version")
    check_version(row[0], what)
    if optional and len(row) >= size:
        row = [*row, *[None] * optional]
    return checked_row(row, what, size + optional)


def unpack_map(packed: Buffer, what: str) -> dict[str, Any]:
    """Return the fields of an envelope that is a map; its `version` is checked.

    Raises:
        ProtocolError: the bytes are no such envelope, or of another version.
    """
    fields = _unpack(packed, what)
    if type(fields) is not dict:
        raise ProtocolError(f"{what}: the envelope is {short_repr(fields)}, not a map")
    check_version(fields.get("version"), what)
    return fields


def check_version(version: object, what: str) -> None:
    """Raise ProtocolError, naming both versions, unless the other end speaks ours."""
    if version != PROTOCOL_VERSION or type(version) is not int:
        raise ProtocolError(
            f"{what}: the other end speaks version {short_repr(version)} of the protocol, this one {PROTOCOL_VERSION}; "
            "install the same release of eal-actors at both ends"
        )


def checked_row(row: object, what: str, size: int) -> list[Any]:
    """Return the first `size` fields of a list; later versions may have put more behind them."""
    if type(row) is not list or len(row) < size:
        raise ProtocolError(f"{what}: {short_repr(row)} is not a list of at least {size} fields")
    return row if len(row) == size else row[:size]


def _unpack(packed: Buffer, what: str) -> Any:
    size = packed.nbytes if isinstance(packed, memoryview) else len(packed)
    if size > MAX_ENVELOPE_BYTES:
        raise ProtocolError(f"{what}: an envelope of {size} bytes, more than {MAX_ENVELOPE_BYTES}")
    try:
        return msgpack.unpackb(
            packed,
            object_pairs_hook=_text_keys,
            max_array_len=MAX_ITEMS,
            max_map_len=MAX_ITEMS,
            max_ext_len=0,
        )
    except (ValueError, TypeError, BufferError, msgpack.UnpackException) as error:
        raise ProtocolError(f"{what}: no valid msgpack: {short_repr(str(error) or type(error).__name__)}") from error


def _text_keys(pairs: list[tuple[Any, Any]]) -> dict[str, Any]:
    fields = dict(pairs)
    if len(fields) != len(pairs) or any(type(key) is not str for key in fields):
        raise ValueError("a map holds a key twice, or one that is no text")
    return fields


def data_header(data: EALData) -> tuple[Any, ...]:
    """Return what describes a value beside its payload: C type, shape, unit, frame and time."""
    name = _C_NAMES[data.type, data.is_ptr, data.is_unsigned, data.is_short, data.is_long]
    return name, data.shape, data.unit, data.frame_id, data.stamp_s


def data_from(header: object, payload: Buffer, what: str) -> EALData:
    """Rebuild a value from its header and its payload, which is not copied and must not change any more.

    Raises:
        ProtocolError: the header is none, or the payload is no value of that type.
    """
    name, shape, unit, frame_id, stamp_s = checked_row(header, what, 5)
    form = _C_TYPE_BY_NAME.get(name) if type(name) is str else None
    if form is None:
        raise ProtocolError(f"{what}: there is no type {short_repr(name)}, only {', '.join(_C_TYPE_BY_NAME)}")
    try:
        return EALData.from_payload(
            form.type,
            payload,
            is_ptr=form.is_ptr,
            is_unsigned=form.is_unsigned,
            is_short=form.is_short,
            is_long=form.is_long,
            shape=shape,
            dtype=None if shape is None else form.dtype,
            unit=unit,
            frame_id=frame_id,
            stamp_s=stamp_s,
        )
    except DataError as error:
        raise ProtocolError(f"{what}: {error.message}") from error


def error_body(error: EALError) -> tuple[str | None, ...]:
    """Return an error's code, message, robot and resource; whatever is in them, they can be sent."""
    return error.code, _sendable(error.message), _sendable(error.robot), _sendable(error.resource)


def error_from(body: object, what: str) -> EALError:
    """Rebuild an error; one that this release does not know becomes an EALError with the code in its message.

    Raises:
        ProtocolError: the body is none of an error.
    """
    code, message, robot, resource = checked_row(body, what, 4)
    names = (robot, resource)
    if type(code) is not str or type(message) is not str or any(type(n) not in (str, type(None)) for n in names):
        raise ProtocolError(f"{what}: {short_repr(body)} is not an error's code, message, robot and resource")
    kind = _ERROR_BY_CODE.get(code)
    if kind is None:
        return EALError(f"{message} (an error of a kind unknown here: {code!r})", robot=robot, resource=resource)
    if kind is not ConfigError:
        return kind(message, robot=robot, resource=resource)
    error = ConfigError(())  # the places in a file of the other end mean nothing here
    error.message = message
    error.args = (message,)
    return error.at(robot, resource)


def _sendable(text: str | None) -> str | None:
    if text is None:
        return None
    return str(text)[:MAX_MESSAGE_CHARS].encode("utf-8", "backslashreplace").decode()
