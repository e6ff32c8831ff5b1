"""An actor whose resource's device may be absent: it checks, reports changes, and halts the device when it is back."""

from __future__ import annotations

import functools
from abc import abstractmethod
from collections.abc import Callable
from typing import Final

from typing_extensions import override

from eal_actors.actors.activities import ActivityActor
from eal_actors.actors.call import ResourceCell
from eal_actors.kernel.errors import NotReadyError

READINESS_PERIOD_S: Final = 0.5
"""Fleet time between two readiness checks while nobody calls the resource."""


class ReadinessActor(ActivityActor):
    """The owner of one resource, as far as the readiness of its device goes. Thread: the actor's own."""

    def __init__(self, cell: ResourceCell, capacity: int) -> None:
        super().__init__(cell, capacity)
        self._reports_readiness = False
        self._not_ready: str | None = None

    @abstractmethod
    def on_readiness(self, reason: str | None) -> None:
        """Report why the device is not ready; None if it is."""

    def _watch_readiness(self) -> None:
        self._check_readiness()
        self.actor_inbox.call_later(READINESS_PERIOD_S, self._watch_readiness)

    def _check_readiness(self) -> str | None:
        """Return why the device is not ready, or None; report a change once. Carry out a halt that is due."""
        before, reason = self._not_ready, self.opened.not_ready()
        reason = None if reason is None else str(reason)
        self._not_ready = reason
        if reason is None and self.cell.owes_halt:
            self._log.info("halting now, as requested while it was not ready")
            self.cell.owes_halt = False
            self.cell.owes_halt = not self.guarded(self.opened.halt) or self.cell.owes_halt
        if reason != before:
            self.on_readiness(reason)
        return reason

    def _owe_halt(self, error: NotReadyError) -> bool:
        """Note that the resource must be halted once its device is back; return False if nobody will know of that."""
        if not self._reports_readiness or self.resource is None:
            return False
        if not self.cell.owes_halt:
            self._log.warning("it is halted as soon as it is ready", reason=error.message)
        self.cell.owes_halt = True
        return True

    @override
    def guarded(self, step: Callable[[], object]) -> bool:
        @functools.wraps(step)
        def with_halt_owed() -> None:
            try:
                step()
            except NotReadyError as error:  # a motion that lost its device could not halt it
                if self._owe_halt(error):
                    return
                if self._not_ready is None:
                    raise
                if self.cell.owes_halt:  # otherwise it rests, and the log has said that it is not ready
                    self._log.warning("closed before it could be halted", reason=error.message)

        return super().guarded(with_halt_owed)
