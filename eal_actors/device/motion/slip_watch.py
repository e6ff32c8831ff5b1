"""SlipWatch: finds that the wheels of a motion turn while something holds the robot."""

from __future__ import annotations

import math
from typing import Final

from eal_actors.kernel.errors import BlockedError

MOST_SLIP_M: Final = 0.03
"""Travel of the wheels in a straight drive while something holds the robot."""
MOST_TURN_SLIP_M: Final = 0.01
"""The same in a turn in place; about four degrees."""


class SlipWatch:
    """Ends a motion whose robot is held: it is not where its encoders count it.

    One reading is no evidence: motors also strain when they start, or push something that gives way.
    """

    def __init__(self, *, is_turn: bool) -> None:
        self._most_m = MOST_TURN_SLIP_M if is_turn else MOST_SLIP_M
        self._read_s = -math.inf
        self._travelled_m = 0.0
        self._was_held = False
        self._slipped_m = 0.0

    def update(self, read_s: float, travelled_m: float, *, is_held: bool) -> None:
        """Add a reading; one with the time of the former is ignored.

        `travelled_m` is the travel by the encoders since any place, the same for all readings. `is_held` is whether the
        wheels are driven, but something holds the robot. Raises BlockedError if the wheels have travelled too far while
        it was held.
        """
        if read_s <= self._read_s:
            return
        if is_held and self._was_held:
            self._slipped_m += abs(travelled_m - self._travelled_m)
        self._read_s, self._travelled_m, self._was_held = read_s, travelled_m, is_held
        if self._slipped_m > self._most_m:
            raise slip_error(self._slipped_m)


def slip_error(slipped_m: float) -> BlockedError:
    """Return the error of a motion whose robot is held."""
    return BlockedError(
        f"halted: something holds it, and its wheels have turned {slipped_m:.2f} m in vain: it is not where they count"
    )
