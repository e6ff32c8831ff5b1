"""The arguments of a call: how messages carry them, which ones each method takes, and which calls are stops.

No method has more than one value: it becomes the payload, which is not copied. Texts and ints go into the header.

Arguments come from another machine. Their number, types and lengths are checked before a call enters a mailbox, since
a resource is not written for others, and a full mailbox keeps all their texts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.future import Relay
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.errors import AccessDeniedError, ProtocolError
from eal_actors.wire.format.keys import CallKey
from eal_actors.wire.format.messages import Arguments, CallHeader
from eal_actors.wire.security.access import Rights

_ARGUMENT_TYPES: Final[dict[str, tuple[type, ...]]] = {
    "get_status": (),
    "get_value": (),
    "set_value": (),
    "send_req": (str,),
    "send_cmd": (str,),
    "read_comm": (int,),
    "write_comm": (int,),
    "get_config": (str,),
    "set_config": (str,),
    "halt": (),
}
_TAKE_DATA: Final = frozenset({"set_value", "send_cmd", "write_comm", "set_config"})
_NEED_DATA: Final = frozenset({"set_value", "write_comm"})
_SMALL_BYTES: Final = 32 * 1024
_MAX_TEXT: Final = 4096
"""Limit of a call's texts, since a full mailbox of them may wait. Values have limits of their own."""


def split_arguments(call: Call[Any]) -> tuple[Arguments, EALData | None]:
    """Return a call's arguments as its header and its payload carry them."""
    if len(call.arguments) == 2 and call.arguments[1] is None:  # a command whose text has all
        return call.arguments[:1], None
    plain: list[str | int] = []
    data = None
    for argument in call.arguments:
        if isinstance(argument, EALData):
            data = argument
        elif argument is not None:
            plain.append(argument)
    return tuple(plain), data


def is_small(call: Call[Any]) -> bool:
    """Return whether a call fits into one batch of a link."""
    for item in call.arguments:  # noqa: SIM110  # a generator takes three times as long, in every command
        if type(item) is EALData and item.length > _SMALL_BYTES:
            return False
    return True


def start_call(
    handle: ResourceHandle,
    method: str,
    header: CallHeader,
    data: EALData | None,
    timeout_s: float,
    begin_by_s: float | None = None,
    start_s: float | None = None,
    prepare: Callable[[Call[Any]], Relay] | None = None,
) -> Call[Any]:
    """Call a resource for a controller; ProtocolError if the arguments do not fit. Thread: any; does not block."""
    plain = header.arguments
    arguments: tuple[Any, ...] = plain
    check_arguments(method, plain, data)
    if method in _TAKE_DATA:
        arguments = (data, *plain) if method in _NEED_DATA else (*plain, data)
    return handle.start_call(method, arguments, timeout_s, begin_by_s, start_s, prepare)


def check_arguments(method: str, plain: Arguments, data: EALData | None) -> None:
    """Raise ProtocolError unless a method takes such arguments."""
    if method == "send_cmd" and len(plain) == 1 and type(text := plain[0]) is str and len(text) <= _MAX_TEXT:
        return  # the most frequent one
    if len(plain) > 1 or (plain and type(plain[0]) is str and len(plain[0]) > _MAX_TEXT):
        check_texts(method, plain, _MAX_TEXT)
    if tuple(map(type, plain)) != _ARGUMENT_TYPES[method] or (data is None and method in _NEED_DATA):
        raise ProtocolError(f"{method} does not take the arguments {plain!r}{'' if data is None else ' and a value'}")


def is_action(info: ResourceInfo | None, arguments: Iterable[object]) -> bool:
    """Return whether a `send_req` is in free text: it may do anything, and so is carried out once at most."""
    return info is not None and not all(info.is_reading(str(req)) for req in arguments)


def check_action(rights: Rights | None, call: CallKey) -> None:
    """Raise AccessDeniedError for a request in free text of a caller that may not command the resource.

    The engine's access control knows the methods alone, and lets observers send requests.
    """
    if rights is not None and not rights.allows(call.resource, "send_cmd"):
        message = f"does not grant a request in free text to {call.caller!r}, which may not command it"
        raise AccessDeniedError(message, resource=call.resource)


def check_texts(method: str, arguments: Iterable[str | int], most: int) -> None:
    """Raise ProtocolError if the texts among the arguments of a call have more than `most` characters in all."""
    length = 0
    for argument in arguments:  # a generator takes twice as long, in every command
        if type(argument) is str:
            length += len(argument)
    if length > most:
        raise ProtocolError(f"{method} does not take texts of {length} characters, but of {most} at most")


def is_stop(handle: ResourceHandle, method: str, header: CallHeader) -> bool:
    """Return whether a call is a command that only stops, which anybody may give at any time, like a halt."""
    arguments = header.arguments
    return method == "send_cmd" and bool(arguments) and arguments[0] in handle.info.urgent_commands
