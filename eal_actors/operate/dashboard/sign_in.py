"""SignIn: checks the tokens of browsers, and keeps out addresses that show wrong ones."""

from __future__ import annotations

import hashlib
import math
import threading
from collections.abc import Mapping
from typing import Final

from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import AccessDeniedError
from eal_actors.managers.fleet_model import OperatorSection
from eal_actors.operate.dashboard.access import Access, Visitor

WRONG_TOKENS: Final = 5
"""Wrong tokens after which an address is kept out."""
KEPT_OUT_S: Final = 60.0
"""Real seconds after the last wrong token for which an address is kept out."""
_MOST_ADDRESSES: Final = 1000


class SignIn:
    """Finds out who a visitor is.

    A token that was right once is known, and passes at once: an operator who reconnects in a hurry waits neither for a
    hash nor for the end of somebody else's lockout. Thread: any.
    """

    def __init__(self, access: Access, clock: Clock = REAL_TIME) -> None:
        self._access = access
        self._clock = clock
        self._lock = threading.Lock()
        self._known: dict[bytes, Visitor] = {}
        self._wrong: dict[str, tuple[int, float]] = {}

    def visitor(self, shown: str | None, source: str) -> Visitor:
        """Return the holder of a token shown from a source, which counts as one address; or None.

        Raises AccessDeniedError if the token is of no operator, or the address is kept out. Thread: blocks for one hash
        if there are operators.
        """
        if shown is None or self._access.is_open:
            return self._access.visitor(shown)
        digest = hashlib.sha256(shown.encode()).digest()
        with self._lock:
            if (known := self._known.get(digest)) is not None:
                return known
            self._count(source)
        operators = self._access.operators
        visitor = self._access.visitor(shown)
        with self._lock:
            if operators is not self._access.operators:
                raise AccessDeniedError("the operators have changed: sign in again")
            if visitor.is_proven:
                self._known[digest] = visitor
                self._wrong.pop(source, None)
        return visitor

    def replace_operators(self, operators: Mapping[str, OperatorSection]) -> None:
        """Let in these operators from now on, with these tokens and roles. Thread: any."""
        with self._lock:
            self._access.operators = operators
            self._known.clear()

    def _count(self, source: str) -> None:
        """Count a token as wrong until it proves right, so that many at once are counted too."""
        now_s = self._clock.now()
        count, end_s = self._wrong.pop(source, (0, 0.0))
        if now_s >= end_s:
            count = 0
        is_out = count >= WRONG_TOKENS
        self._wrong[source] = (count, end_s) if is_out else (count + 1, now_s + KEPT_OUT_S)
        if len(self._wrong) > _MOST_ADDRESSES:
            del self._wrong[next(iter(self._wrong))]
        if is_out:
            left_s = math.ceil(end_s - now_s)
            raise AccessDeniedError(f"too many wrong tokens from {source}: try again in {left_s} s")
