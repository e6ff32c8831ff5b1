"""What a stream wants, and who brings it the values: a poll of this process, or a subscription to another one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias, get_args

from eal_actors.device.data import EALData
from eal_actors.device.data.forms import DataType
from eal_actors.device.info import ResourceInfo, ValueInfo
from eal_actors.kernel.errors import ArgumentError, EALError, UnsupportedError

Encoding: TypeAlias = Literal["raw", "jpeg", "png"]
"""How a frame travels; JPEG loses a little, the others nothing. The reader gets an image again."""

ENCODINGS: Final[tuple[str, ...]] = get_args(Encoding)

MAX_RATE_HZ: Final = 1000.0


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """What a stream wants.

    Attributes:
        rate_hz: values in a second of the fleet's clock, at most.
        encoding: how frames travel.

    Raises:
        ArgumentError: the rate is not over 0 and up to MAX_RATE_HZ, or there is no such encoding.
    """

    rate_hz: float
    encoding: Encoding

    def __post_init__(self) -> None:
        rate_hz: object = self.rate_hz
        is_number = isinstance(rate_hz, int | float) and not isinstance(rate_hz, bool) and math.isfinite(rate_hz)
        if not is_number or not 0 < self.rate_hz <= MAX_RATE_HZ:
            raise ArgumentError(f"rate_hz must be over 0 and up to {MAX_RATE_HZ:g}, not {rate_hz!r}")
        if self.encoding not in ENCODINGS:
            raise ArgumentError(f"encoding must be one of {', '.join(ENCODINGS)}, not {self.encoding!r}")

    @property
    def period_s(self) -> float:
        """Seconds of the fleet's clock from value to value."""
        return 1 / self.rate_hz

    def check_resource(self, info: ResourceInfo) -> None:
        """Raise UnsupportedError or ArgumentError if it is known already that a resource cannot stream so."""
        if "get_value" not in info.methods:
            raise UnsupportedError("has no get_value, so there is nothing to stream")
        if self.encoding != "raw" and info.value is not None and not _may_be_image(info.value):
            raise ArgumentError(f"{_no_image(self.encoding)}, and its value is {info.value.describe()}")

    def check_value(self, data: EALData) -> None:
        """Raise ArgumentError unless a value can travel so."""
        if self.encoding != "raw" and not _is_image(data):
            shown = f"{data.dtype} of shape {data.shape}" if data.shape is not None else repr(data.type.name.lower())
            raise ArgumentError(f"{_no_image(self.encoding)}, and this value is {shown}")


def _may_be_image(value: ValueInfo) -> bool:
    return value.type is DataType.CHAR and (not value.shape or (len(value.shape) == 3 and value.shape[2] in (3, None)))


def _is_image(data: EALData) -> bool:
    shape = data.shape
    return data.dtype == "|u1" and shape is not None and len(shape) == 3 and shape[2] == 3 and data.length > 0


def _no_image(encoding: str) -> str:
    return f"the encoding {encoding!r} is for images alone, uint8 of shape (height, width, 3)"


Item: TypeAlias = EALData | EALError | Callable[[], EALData]
"""What a feed brings: a value, why there is none, or what makes the value, in the thread that reads it."""


class Sink(Protocol):
    """Where a feed brings what it gets."""

    def offer(self, item: Item) -> None:
        """Take the place of what was brought before. Thread: any; does not block."""
        ...


class Feed(Protocol):
    """Brings values until it is closed."""

    def close(self) -> None:
        """Bring nothing more. Calling it twice is harmless. Thread: any; does not block."""
        ...
