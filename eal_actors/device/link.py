"""The link from the controllers of a robot to its resources, on which faults can be injected."""

from __future__ import annotations

import random
import threading
import zlib
from collections.abc import Iterable


class FaultyLink:
    """A link that a fault plan may delay, make lossy or cut, to test controllers.

    Lost calls are not refused: they reach no resource, and their callers wait until their deadlines, as with a robot
    out of reach. The losses depend on the fleet's seed, the robot's name and the calls alone. Calls to `spared`,
    resources beside the robot such as ground truth, always arrive. Thread: any.
    """

    def __init__(self, robot: str, seed: int = 0) -> None:
        self.is_faulty = False
        self.spared: frozenset[str] = frozenset()
        self.lost = 0
        self._delay_s = 0.0
        self._loss = 0.0
        self._is_cut = False
        self._lock = threading.Lock()
        self._random = random.Random(zlib.crc32(f"{seed} {robot}".encode()))  # noqa: S311  # a simulation

    @property
    def delay_s(self) -> float:
        """The transit time of each call, in seconds of the fleet's clock."""
        return self._delay_s

    @property
    def loss(self) -> float:
        """The share of calls that are lost, 0..1."""
        return self._loss

    @property
    def is_cut(self) -> bool:
        """Whether no call arrives."""
        return self._is_cut

    def spare(self, resources: Iterable[str]) -> None:
        """Exempt these resources: their calls always arrive."""
        self.spared = self.spared.union(resources)

    def impair(self, *, delay_s: float | None = None, loss: float | None = None, is_cut: bool | None = None) -> None:
        """Set a delay of at least 0, a loss in 0..1, or whether no call arrives; None leaves each as it is."""
        with self._lock:
            self._delay_s = self._delay_s if delay_s is None else float(delay_s)
            self._loss = self._loss if loss is None else float(loss)
            self._is_cut = self._is_cut if is_cut is None else is_cut
            self.is_faulty = bool(self._delay_s or self._loss or self._is_cut)

    def delay_of_next_s(self) -> float | None:
        """Return the transit time of the next call, or None if it is lost."""
        with self._lock:
            if self._is_cut or (self._loss and self._random.random() < self._loss):
                self.lost += 1
                return None
            return self._delay_s
