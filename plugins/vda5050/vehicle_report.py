"""VehicleReport: the errors and action states of one vehicle, as its next state message tells them."""

from __future__ import annotations

from typing import Any, Final

from eal_actors.plugin import LogLimit, get_logger

from .messages import ActionState, AgvAction, AgvError, Reference

_MOST_ACTIONS: Final = 50
"""Actions that are over and still reported."""
_MOST_ERRORS: Final = 10
_MOST_SHOWN: Final = 500


class VehicleReport:
    """The errors and actions of one vehicle.

    Args:
        robot: its name, for the log.

    Attributes:
        is_due: whether something has changed since `is_due` was cleared.
    """

    def __init__(self, robot: str) -> None:
        self.is_due = True
        self.errors: list[AgvError] = []
        self._actions: dict[str, ActionState] = {}
        self._log = get_logger(robot=robot)
        self._logged = LogLimit()

    @property
    def is_fatal(self) -> bool:
        """Whether an error must be cleared before the vehicle goes on."""
        return any(error.error_level == "FATAL" for error in self.errors)

    @property
    def actions(self) -> list[ActionState]:
        """The states of the actions."""
        return list(self._actions.values())

    def add(self, kind: str, description: str, *, level: Any = "WARNING", **references: str) -> None:
        """Add an error, and log it."""
        found = [Reference(reference_key=key, reference_value=value) for key, value in references.items()]
        self.keep(AgvError(error_type=kind, error_level=level, error_description=description, error_references=found))
        if (more := self._logged.admit()) is not None:
            self._log.warning("the vehicle reports an error", kind=kind, reason=description[:_MOST_SHOWN], **more)

    def keep(self, error: AgvError) -> None:
        """Add an error that others know of."""
        self.errors = [*self.errors[1 - _MOST_ERRORS :], error]
        self.is_due = True

    def clear(self, *, keep_fatal: bool = False) -> None:
        """Forget the errors, or only the warnings."""
        self.errors = [error for error in self.errors if keep_fatal and error.error_level == "FATAL"]
        self.is_due = True

    def await_actions(self, actions: list[AgvAction]) -> None:
        """Add actions that are not begun."""
        for action in actions:
            self._actions.setdefault(action.action_id, _state(action, "WAITING"))

    def set_action(self, action: AgvAction, status: Any, result: str | None = None) -> None:
        """Set the state of an action; the oldest that are over are forgotten."""
        self._actions.pop(action.action_id, None)
        self._actions[action.action_id] = _state(action, status, result)
        over = [name for name, one in self._actions.items() if one.action_status in ("FINISHED", "FAILED")]
        for name in over[: max(0, len(over) - _MOST_ACTIONS)]:
            del self._actions[name]
        self.is_due = True


def _state(action: AgvAction, status: Any, result: str | None = None) -> ActionState:
    return ActionState(
        action_id=action.action_id,
        action_type=action.action_type,
        action_status=status,
        result_description=result,
    )
