"""Limits for each browser."""

from __future__ import annotations

from typing import Final

MAX_MESSAGE_BYTES: Final = 16 * 1024
"""The size of a message from a browser."""
MAX_BROWSERS: Final = 32
MAX_CAMERAS: Final = 4
"""Cameras that one browser may watch at once."""
MAX_FRAMES_PER_S: Final = 15.0
COMMANDS_PER_S: Final = 10.0
COMMANDS_AT_ONCE: Final = 20.0
MESSAGES_PER_S: Final = 60.0
MESSAGES_AT_ONCE: Final = 120.0


class TokenBucket:
    """A rate limit: `per_s` tokens are added per second, up to `at_once`, which is also the number at the start."""

    def __init__(self, per_s: float, at_once: float) -> None:
        self._per_s = per_s
        self._most = at_once
        self._left = at_once
        self._last_s: float | None = None

    def take(self, now_s: float) -> bool:
        """Take a token; return False if none is left."""
        if self._last_s is not None:
            self._left = min(self._most, self._left + (now_s - self._last_s) * self._per_s)
        self._last_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True
