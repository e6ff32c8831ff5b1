"""Steps that wait: for time, for a reading, for each other."""

from __future__ import annotations

from pydantic import PositiveFloat

from eal_actors.kernel.strict_model import Name
from eal_actors.scenario.model.base import FallibleStep, WaitingStep
from eal_actors.scenario.model.values import Count, ExpressionText, Seconds, Value, VariableName

POLL_S = 0.1


class WaitStep(FallibleStep):
    """Let time pass."""

    kind = "wait_s"
    wait_s: Seconds
    """Seconds of the fleet's clock."""


class WaitUntilStep(WaitingStep):
    """Wait until an expression is true."""

    kind = "wait_until"
    wait_until: ExpressionText
    """An expression, without `${}`."""
    poll_s: PositiveFloat = POLL_S
    """How long to wait from one look to the next, in seconds of the fleet's clock."""


class BarrierStep(WaitingStep):
    """Meet with everyone whose `on` or branch has a barrier of this name."""

    kind = "barrier"
    barrier: Name


class SignalStep(FallibleStep):
    """Tell everyone who waits for this signal, now or later."""

    kind = "signal"
    signal: Name
    value: Value | None = None
    """What `wait_for` saves; the robot's name if left out."""


class WaitForStep(WaitingStep):
    """Wait for a signal; one that came before counts."""

    kind = "wait_for"
    wait_for: Name
    count: Count = 1
    """How often it must have come since the beginning of the run."""
    save_as: VariableName | None = None
    """Variable that keeps the signal's newest value."""
    default: Value | None = None
    """What it keeps when time is up, in place of a failure."""
