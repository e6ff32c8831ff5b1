"""Sticks: the state of a gamepad or a keyboard, from the bytes of its events; pure functions.

Source: Linux, include/uapi/linux/input.h (`struct input_event`) and input-event-codes.h.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

EVENT: Final = struct.Struct("@llHHi")
"""Seconds, microseconds, type, code and value, in the machine's own layout."""
EV_SYN: Final = 0
EV_KEY: Final = 1
EV_ABS: Final = 3
SYN_DROPPED: Final = 3
ABS_X: Final = 0
ABS_Y: Final = 1
BTN_SOUTH: Final = 0x130
BTN_TL: Final = 0x136
BTN_TR: Final = 0x137
BTN_SELECT: Final = 0x13A
BTN_START: Final = 0x13B
KEY_TAB: Final = 15
DEAD_MEN: Final = frozenset({BTN_TL, BTN_TR})
"""The shoulder buttons."""
NEXT_GROUP: Final = frozenset({BTN_SELECT, BTN_START, KEY_TAB})
KEYS: Final[Mapping[int, tuple[int, int]]] = {
    17: (1, 0),
    103: (1, 0),  # W, up
    31: (-1, 0),
    108: (-1, 0),  # S, down
    30: (0, 1),
    105: (0, 1),  # A, left
    32: (0, -1),
    106: (0, -1),  # D, right
}
"""Key codes, each with its part of the way ahead and to the left."""
DEAD_ZONE: Final = 0.12


class InputEvent(NamedTuple):
    """An event of a device."""

    type: int
    code: int
    value: int


class AxisRange(NamedTuple):
    """The range of an axis's values."""

    low: int = -32768
    high: int = 32767


class EventReader:
    """Splits a stream of bytes into events, wherever reads cut it."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> Iterator[InputEvent]:
        """Yield the events that are complete."""
        content = self._rest + data
        whole = len(content) - len(content) % EVENT.size
        self._rest = content[whole:]
        for _, _, kind, code, value in EVENT.iter_unpack(content[:whole]):
            yield InputEvent(kind, code, value)


class Sticks:
    """The deflection of a device: ahead and to the left, from -1 to 1, while its dead-man is held.

    The dead-man of a gamepad is a shoulder button; of a keyboard, the keys that drive. After lost events nothing is
    held until it is released and pressed again. `ranges` are those of the axes by code; `expo` is the curve of the
    stick, from 0, linear, to 1, cubic. `press` counts the times that the dead-man was pressed, and `group_steps` those
    of the button that chooses the next robots.
    """

    def __init__(self, ranges: Mapping[int, AxisRange] | None = None, expo: float = 0.6) -> None:
        self._ranges = {code: AxisRange() for code in (ABS_X, ABS_Y)} | dict(ranges or {})
        self._expo = expo
        self._axes: dict[int, float] = {}
        self._held: set[int] = set()
        self._ignored: set[int] = set()
        self.press = 0
        self.group_steps = 0

    @property
    def is_held(self) -> bool:
        """Whether a dead-man is held."""
        return bool(self._held)

    def feed(self, event: InputEvent) -> None:
        """Apply an event; unknown ones are ignored."""
        if event.type == EV_SYN and event.code == SYN_DROPPED:
            self.let_go()
        elif event.type == EV_ABS and event.code in self._ranges:
            self._axes[event.code] = _normalized(event.value, self._ranges[event.code])
        elif event.type == EV_KEY:
            self._feed_key(event)

    def let_go(self) -> None:
        """End the press: keys that are held count again only after their release."""
        self._ignored |= self._held
        self._held.clear()
        self._axes.clear()

    def _feed_key(self, event: InputEvent) -> None:
        if event.code in NEXT_GROUP and event.value == 1 and not self.is_held:
            self.group_steps += 1
        if event.code not in DEAD_MEN and event.code not in KEYS:
            return
        if event.value == 0:
            self._held.discard(event.code)
            self._ignored.discard(event.code)
        elif event.value == 1 and event.code not in self._ignored:  # 2 repeats a key that is held
            self.press += not self._held
            self._held.add(event.code)

    def wish(self) -> tuple[float, float]:
        """Return the deflection ahead and to the left; both 0 while nothing is held."""
        ahead = left = 0.0
        if self._held & DEAD_MEN:
            ahead = -curved(self._axes.get(ABS_Y, 0.0), self._expo)
            left = -curved(self._axes.get(ABS_X, 0.0), self._expo)
        for code in self._held & KEYS.keys():
            ahead += KEYS[code][0]
            left += KEYS[code][1]
        return max(-1.0, min(1.0, ahead)), max(-1.0, min(1.0, left))


def curved(value: float, expo: float) -> float:
    """Return the curved value of an axis: 0 within the dead zone, fine near it, 1 at the end."""
    size = max(0.0, (abs(value) - DEAD_ZONE) / (1 - DEAD_ZONE))
    curve = (1 - expo) * size + expo * size**3
    return curve if value > 0 else -curve


def _normalized(value: int, limits: AxisRange) -> float:
    if limits.high <= limits.low:
        return 0.0
    middle, half = (limits.low + limits.high) / 2, (limits.high - limits.low) / 2
    return max(-1.0, min(1.0, (value - middle) / half))
