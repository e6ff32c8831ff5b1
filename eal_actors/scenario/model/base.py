"""What every step may say, and what the steps that can fail or wait may say."""

from __future__ import annotations

from typing import ClassVar

from eal_actors.kernel.strict_model import StrictModel
from eal_actors.scenario.model.policies import OnFailure
from eal_actors.scenario.model.values import Timeout


class Step(StrictModel):
    """Something to do.

    Attributes:
        kind: the key that tells what the step is.
    """

    kind: ClassVar[str]

    safe_to_repeat: bool | None = None
    """For steps of the top level: a run that is resumed may go through it once more; the file's if left out."""


class FallibleStep(Step):
    """A step that can fail."""

    on_failure: OnFailure | None = None
    """What happens then; that of the block around it, of the role or of the file if left out."""


class TimedStep(FallibleStep):
    """A step whose time is limited."""

    timeout_s: Timeout | None = None
    """Deadline of each attempt, in seconds of the fleet's clock; the file's if left out."""


class BlockStep(FallibleStep):
    """A step that holds steps."""

    timeout_s: Timeout | None = None
    """How long all of it may take, in seconds of the fleet's clock; inside an `on` each robot, and so the `do` of an
    `on`. What is under way then is stopped, and the block has failed."""


class WaitingStep(FallibleStep):
    """A step that waits for something that may never happen."""

    timeout_s: Timeout
    """How long it waits at most, in seconds of the fleet's clock."""
