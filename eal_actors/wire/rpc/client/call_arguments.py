"""The arguments of a call, as messages carry them.

No method has more than one value: it becomes the payload, which is not copied. Texts and ints go into the header.
"""

from __future__ import annotations

from typing import Any, Final

from eal_actors.actors.call import Call
from eal_actors.device.data import EALData

_SMALL_BYTES: Final = 32 * 1024


def split_arguments(call: Call[Any]) -> tuple[tuple[str | int, ...], EALData | None]:
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
