"""Readiness: whether a resource's device can be used now, as the resource says itself."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import structlog

from eal_actors.actors.inbox import Inbox
from eal_actors.device.resource import Resource
from eal_actors.kernel.errors import NotReadyError

LOOK_S: Final = 0.5
"""How often (fleet time) a resource is asked while nobody calls it."""


class Readiness:
    """Asks a resource that can be not ready, before each call and now and again; a change is logged once.

    Args:
        resource: whom to ask.
        inbox: its actor's.
        tell: takes each look's answer: why it is not ready, or None.
        log: where changes are written.

    Thread: the resource's actor.
    """

    def __init__(
        self,
        resource: Resource,
        inbox: Inbox,
        tell: Callable[[str | None], None],
        log: structlog.typing.FilteringBoundLogger,
    ) -> None:
        self._resource = resource
        self._inbox = inbox
        self._tell = tell
        self._log = log
        self._reason: str | None = None

    def watch(self) -> None:
        """Ask now, and again and again from now on."""
        self._ask()
        self._inbox.call_later(LOOK_S, self.watch)

    def require(self) -> None:
        """Raise NotReadyError if it is not ready."""
        if (reason := self._ask()) is not None:
            raise NotReadyError(reason)

    def _ask(self) -> str | None:
        before, reason = self._reason, self._resource.not_ready()
        self._reason = reason
        if reason is not None and before is None:
            self._log.warning("not ready", reason=reason)
        elif reason is None and before is not None:
            self._log.info("ready again")
        if reason != before:
            self._tell(reason)
        return reason
