"""How the arguments of the ten methods travel: texts and ints in the header, the one value beside it."""

from __future__ import annotations

from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.actors.handles import ResourceHandle
from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ProtocolError

READS: Final = frozenset({"get_status", "get_value", "get_config", "send_req"})
"""Methods that change nothing, so that asking again does no harm. Reading a stream takes bytes out of it."""

_BATCH_BYTES: Final = 32 * 1024


def split_arguments(call: Call[Any]) -> tuple[tuple[str | int, ...], EALData | None]:
    """Return a call's arguments as its header and its payload carry them."""
    plain: list[str | int] = []
    data = None
    for argument in call.arguments:
        if isinstance(argument, EALData):
            data = argument
        elif argument is not None:
            plain.append(argument)
    return tuple(plain), data


def is_small(call: Call[Any]) -> bool:
    """Return whether a call goes into one batch of a link, so that sending it cannot take long."""
    return all(item.length <= _BATCH_BYTES for item in call.arguments if isinstance(item, EALData))


_TAKES: Final[dict[str, tuple[type, ...]]] = {
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


def start_call(
    handle: ResourceHandle,
    method: str,
    plain: tuple[str | int, ...],
    data: EALData | None,
    timeout_s: float,
    begin_by_s: float | None,
    start_s: float | None = None,
) -> Call[Any]:
    """Call a resource as another machine asked for it; see ResourceHandle.start_call. Thread: any; does not block.

    Raises:
        ProtocolError: the method does not take such arguments.
    """
    arguments: tuple[Any, ...] = plain
    if tuple(map(type, plain)) != _TAKES[method] or (data is None and method in _NEED_DATA):
        raise ProtocolError(f"{method} does not take the arguments {plain!r}{'' if data is None else ' and a value'}")
    if method in _TAKE_DATA:
        arguments = (data, *plain) if method in ("set_value", "write_comm") else (*plain, data)
    return handle.start_call(method, arguments, timeout_s, begin_by_s, start_s)
