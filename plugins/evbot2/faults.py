"""A wire that loses, doubles and reorders what it carries: for tests, and for emulators that are to be bad company."""

from __future__ import annotations

from random import Random


class FaultyWire:
    """Carries pieces, such as datagrams or lines, one way. It knows no time: what is held back comes with a later one.

    Args:
        random: decides what befalls each piece.
        loss: share of the pieces that never arrive, 0..1.
        duplicate: share of those that arrive twice, the second time perhaps much later, 0..1.
        reorder: share of the others that are held back, 0..1.
    """

    def __init__(self, random: Random, loss: float = 0.0, duplicate: float = 0.0, reorder: float = 0.0) -> None:
        self._random = random
        self._loss = loss
        self._duplicate = duplicate
        self._reorder = reorder
        self._held: list[bytes] = []

    def carry(self, piece: bytes) -> list[bytes]:
        """Take a piece and return those that arrive now, in the order in which they do."""
        arriving = []
        if self._random.random() >= self._loss:
            is_late = self._random.random() < self._reorder
            if not is_late:
                arriving.append(piece)
            if is_late or self._random.random() < self._duplicate:
                self._held.append(piece)
        while self._held and self._random.random() < 0.5:
            arriving.append(self._held.pop(self._random.randrange(len(self._held))))
        return arriving
