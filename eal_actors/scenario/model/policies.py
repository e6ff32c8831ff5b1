"""What happens when a step fails."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import Discriminator, Field, NonNegativeFloat, PositiveInt, Tag

from eal_actors.kernel.strict_model import StrictModel

Action = Literal["abort", "drop", "skip", "substitute"]


class RetryPolicy(StrictModel):
    """Try again before giving up."""

    retry: PositiveInt
    """How many more attempts."""
    back_off_s: NonNegativeFloat = 0.0
    """Pause before the next attempt, in seconds of the fleet's clock."""
    factor: float = Field(default=1.0, ge=1.0, le=10.0)
    """By how much the pause grows from attempt to attempt."""
    then: Action = "abort"
    """What to do when the last attempt has failed."""

    def pause_s(self, attempt: int) -> float:
        """Return the pause after an attempt that failed, counted from 1."""
        return self.back_off_s * self.factor ** min(attempt - 1, 100)


def _policy_kind(value: object) -> str:
    return "RetryPolicy" if isinstance(value, Mapping | RetryPolicy) else "Action"


OnFailure = Annotated[
    Annotated[Action, Tag("Action")] | Annotated[RetryPolicy, Tag("RetryPolicy")], Discriminator(_policy_kind)
]
"""`abort` ends the run, `drop` goes on without the robot, `skip` goes on with the next step, `substitute` lets a spare
of the role take the robot's place."""


def final_action(policy: Action | RetryPolicy) -> Action:
    """Return what a policy does when no attempt is left."""
    return policy.then if isinstance(policy, RetryPolicy) else policy
