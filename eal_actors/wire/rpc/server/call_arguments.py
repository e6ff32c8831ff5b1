"""How a robot calls a resource for a controller: which arguments each method takes, and which calls are stops.

Arguments come from another machine. Their number, types and lengths are checked before a call enters a mailbox, since
a resource is not written for others, and a full mailbox keeps all their texts.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ProtocolError
from eal_actors.wire.format.messages import CallHeader

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
_MAX_TEXT: Final = 4096
"""Limit of a call's texts, since a full mailbox of them may wait. Values have limits of their own."""


def start_call(
    handle: ResourceHandle,
    method: str,
    header: CallHeader,
    data: EALData | None,
    timeout_s: float,
    begin_by_s: float | None = None,
    start_s: float | None = None,
) -> Call[Any]:
    """Call a resource for a controller; see ResourceHandle.start_call. Thread: any; does not block.

    Raises:
        ProtocolError: the method does not take such arguments.
    """
    plain = header.arguments
    arguments: tuple[Any, ...] = plain
    check_arguments(method, plain, data)
    if method in _TAKE_DATA:
        arguments = (data, *plain) if method in ("set_value", "write_comm") else (*plain, data)
    return handle.start_call(method, arguments, timeout_s, begin_by_s, start_s)


def check_arguments(method: str, plain: tuple[str | int, ...], data: EALData | None) -> None:
    """Raise ProtocolError unless a method takes such arguments."""
    if len(plain) > 1 or (plain and type(plain[0]) is str and len(plain[0]) > _MAX_TEXT):
        check_texts(method, plain, _MAX_TEXT)
    if tuple(map(type, plain)) != _ARGUMENT_TYPES[method] or (data is None and method in _NEED_DATA):
        raise ProtocolError(f"{method} does not take the arguments {plain!r}{'' if data is None else ' and a value'}")


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
    return method == "send_cmd" and header.arguments[:1] != () and header.arguments[0] in handle.info.urgent_commands
