"""Faults on purpose: what may be wrong with a simulated robot, and the plan by which it becomes so. Pure.

What a fault does is said here, once: the settings, the resource Faults and the documentation take it from the fields.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final, Literal, Self, get_args

from pydantic import model_validator

from eal_actors.plugin import Field, PluginSettingsModel

SensorName = Literal[
    "Odometry",
    "Battery",
    "Bump",
    "Range",
    "Compass",
    "Light",
    "Beacons",
    "Camera",
    "Cliff",
    "WheelDrop",
    "Wall",
    "Buttons",
]
"""The sensors that can freeze: all but the ground truth."""

SENSORS: Final[tuple[str, ...]] = get_args(SensorName)


class FaultSet(PluginSettingsModel):
    """What is wrong with a robot; nothing, unless it is said."""

    motor_left: float = Field(
        default=1.0, ge=0, le=1, description="Weak motor: share of its commanded speed that the left wheel reaches."
    )
    motor_right: float = Field(
        default=1.0, ge=0, le=1, description="Weak motor: share of its commanded speed that the right wheel reaches."
    )
    stuck_left: bool = Field(default=False, description="The left wheel is jammed: it and its encoder stand still.")
    stuck_right: bool = Field(default=False, description="The right wheel is jammed: it and its encoder stand still.")
    frozen: tuple[SensorName, ...] = Field(
        default=(), strict=False, description="Sensors that keep answering what they answered last, with its old stamp."
    )
    camera_black: bool = Field(default=False, description="The camera's pictures are black.")
    battery_empty: bool = Field(
        default=False, description="The battery holds nothing: the motors stop, and do not start."
    )
    dead: bool = Field(default=False, description="The robot is off: its motors stop, and it answers nothing.")
    link_delay_s: float = Field(
        default=0.0, ge=0, le=3600, description="Seconds that each call is on its way to the robot."
    )
    link_loss: float = Field(default=0.0, ge=0, le=1, description="Share of the calls that never arrive.")
    link_cut: bool = Field(default=False, description="No call arrives.")

    @property
    def wheel_shares(self) -> tuple[float, float]:
        """The shares of what they are commanded that the left and the right wheel turn."""
        return 0.0 if self.stuck_left else self.motor_left, 0.0 if self.stuck_right else self.motor_right

    @property
    def present(self) -> dict[str, Any]:
        """The faults that are there, by name."""
        return {
            name: value for name in FaultSet.model_fields if (value := getattr(self, name)) != getattr(HEALTHY, name)
        }

    def with_changes(self, changes: Mapping[str, Any]) -> FaultSet:
        """Return the faults after some have changed; the values are checked already."""
        return self.model_copy(update=changes)


HEALTHY: Final = FaultSet()
"""Nothing is wrong."""


class PlannedFault(FaultSet):
    """Faults that begin at a time, and end at a time or not at all."""

    at_s: float = Field(ge=0)
    """When they begin, in seconds of the fleet's clock, as in all stamps."""
    until_s: float | None = None
    """When they end; never if left out."""

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        if not self.changes:
            raise ValueError(f"names no fault; there are {', '.join(FaultSet.model_fields)}")
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"ends at {self.until_s:g} s, but begins only at {self.at_s:g} s")
        return self

    @property
    def changes(self) -> dict[str, Any]:
        """The faults that it sets, by name."""
        return {name: getattr(self, name) for name in FaultSet.model_fields if name in self.model_fields_set}


class FaultPlan:
    """What is to happen to one robot, and when. What has happened is not planned any more.

    Args:
        planned: in any order; of what begins or ends at the same time, the later in the list has the last word.
    """

    def __init__(self, planned: Sequence[PlannedFault] = ()) -> None:
        steps = [(fault.at_s, fault.changes) for fault in planned]
        ends = [(fault.until_s, fault.changes) for fault in planned if fault.until_s is not None]
        healthy = [(end_s, {name: getattr(HEALTHY, name) for name in changes}) for end_s, changes in ends]
        self._steps = sorted(healthy + steps, key=lambda step: step[0])  # what ends makes way for what begins

    @property
    def next_s(self) -> float:
        """When something happens next; infinity for never."""
        return self._steps[0][0] if self._steps else math.inf

    def take_due(self, now_s: float) -> dict[str, Any]:
        """Return what has changed by a time, by name, and plan it no more."""
        changes: dict[str, Any] = {}
        while self.next_s <= now_s:
            changes |= self._steps.pop(0)[1]
        return changes
