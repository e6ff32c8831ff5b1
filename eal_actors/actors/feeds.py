"""Stream specifications, and the interface of the feeds that bring a stream its values.

In this process a feed polls the resource; a remote resource has a subscription. Both offer to the same stream.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

from eal_actors.device.data import DataType, EALData
from eal_actors.device.data.images import ENCODINGS, Encoding
from eal_actors.device.info import ResourceInfo, ValueInfo
from eal_actors.kernel.errors import ArgumentError, EALError, UnsupportedError

MAX_RATE_HZ: Final = 1000.0


@dataclass(frozen=True, slots=True)
class StreamSpec:
    """The rate and encoding of a stream.

    `rate_hz` is the most values in a second of the fleet's clock. Raises ArgumentError if the rate is not over 0 and up
    to MAX_RATE_HZ, or the encoding is unknown.
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
        """Raise UnsupportedError or ArgumentError if the resource's information rules the stream out."""
        if "get_value" not in info.methods:
            raise UnsupportedError("has no get_value, so there is nothing to stream")
        if self.encoding != "raw" and info.value is not None and not _may_be_image(info.value):
            raise ArgumentError(f"{_images_only(self.encoding)}, and its value is {info.value.describe()}")

    def check_value(self, data: EALData) -> None:
        """Raise ArgumentError unless the encoding can carry the value."""
        if self.encoding != "raw" and not _is_image(data):
            what = f"{data.dtype} of shape {data.shape}" if data.shape is not None else repr(data.type.name.lower())
            raise ArgumentError(f"{_images_only(self.encoding)}, and this value is {what}")


def _may_be_image(value: ValueInfo) -> bool:
    return value.type is DataType.CHAR and (not value.shape or (len(value.shape) == 3 and value.shape[2] in (3, None)))


def _is_image(data: EALData) -> bool:
    shape = data.shape
    return data.dtype == "|u1" and shape is not None and len(shape) == 3 and shape[2] == 3 and data.length > 0


def _images_only(encoding: str) -> str:
    return f"the encoding {encoding!r} is for images alone, uint8 of shape (height, width, 3)"


Item: TypeAlias = EALData | EALError | Callable[[], EALData]
"""An item of a feed: a value, an error, or a function that makes the value in the reader's thread."""

Sink: TypeAlias = Callable[[Item], None]
"""Receives the newest item, in place of the one before. Thread: any; does not block."""


class Feed(Protocol):
    """Delivers values to a sink until it is closed."""

    def close(self) -> None:
        """Stop delivering. Calling it twice is harmless. Thread: any; does not block."""
