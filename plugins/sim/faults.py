"""Injected faults of a simulated robot, and the plan of when they begin and end. Pure.

The fields describe each fault once. The settings, the resource Faults and the documentation use their descriptions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final, Literal, Self, get_args

from pydantic import model_validator

from eal_actors.plugin import Field, PluginSettingsModel

SensorName = Literal[
    "Odometry",
    "Pose",
    "Battery",
    "Bump",
    "Range",
    "Compass",
    "Light",
    "Beacons",
    "Camera",
    "Lidar",
    "Imu",
    "DepthCamera",
    "Cliff",
    "WheelDrop",
    "Wall",
    "Buttons",
]
"""The sensors that can freeze: all except the true pose."""

SENSORS: Final[tuple[str, ...]] = get_args(SensorName)


class FaultSet(PluginSettingsModel):
    """The faults of a robot; without arguments, it is healthy."""

    motor_left: float = Field(
        default=1.0, ge=0, le=1, description="Weak motor: share of its commanded speed that the left wheel reaches."
    )
    motor_right: float = Field(
        default=1.0, ge=0, le=1, description="Weak motor: share of its commanded speed that the right wheel reaches."
    )
    stuck_left: bool = Field(default=False, description="The left wheel is jammed: it and its encoder stand still.")
    stuck_right: bool = Field(default=False, description="The right wheel is jammed: it and its encoder stand still.")
    frozen: tuple[SensorName, ...] = Field(
        default=(), strict=False, description="Sensors that repeat their last answer, with its old stamp."
    )
    failing: tuple[str, ...] = Field(
        default=(), strict=False, description="Resources whose calls fail with ResourceFaultError."
    )
    blocked_ahead: bool = Field(
        default=False, description="Something stands ahead, whichever way it turns: forward motions stall."
    )
    camera_black: bool = Field(default=False, description="The camera's pictures are black.")
    battery_empty: bool = Field(default=False, description="The battery is empty: the motors stop and cannot start.")
    dead: bool = Field(default=False, description="The robot is off: its motors stop, and it answers nothing.")
    link_delay_s: float = Field(default=0.0, ge=0, le=3600, description="Delay of each call to the robot, in seconds.")
    link_loss: float = Field(default=0.0, ge=0, le=1, description="Share of the calls that are lost.")
    link_cut: bool = Field(default=False, description="All calls are lost.")

    @property
    def wheel_shares(self) -> tuple[float, float]:
        """The shares of their commands that the left and the right wheel turn."""
        return 0.0 if self.stuck_left else self.motor_left, 0.0 if self.stuck_right else self.motor_right

    def stalled_wheels(self, *, forward: bool) -> str:
        """Return the wheels that do not turn when they are driven, in words; empty for none."""
        stalled = {
            "left": self.stuck_left or (forward and self.blocked_ahead),
            "right": self.stuck_right or (forward and self.blocked_ahead),
        }
        return " and the ".join(side for side, is_stalled in stalled.items() if is_stalled)

    @property
    def present(self) -> dict[str, Any]:
        """The present faults, by name."""
        return {
            name: value for name in FaultSet.model_fields if (value := getattr(self, name)) != getattr(HEALTHY, name)
        }


HEALTHY: Final = FaultSet()
"""No faults."""


class PlannedFault(FaultSet):
    """Faults that begin at a time, and end at a time or never."""

    at_s: float = Field(ge=0)
    """When they begin, in seconds of the fleet's clock, as in all stamps."""
    until_s: float | None = None
    """When they end; never if left out."""

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        if not self.changes:
            raise ValueError(f"names no fault; use {', '.join(FaultSet.model_fields)}")
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"ends at {self.until_s:g} s, but begins only at {self.at_s:g} s")
        return self

    @property
    def changes(self) -> dict[str, Any]:
        """The faults that it sets, by name."""
        return {name: getattr(self, name) for name in FaultSet.model_fields if name in self.model_fields_set}


class FaultPlan:
    """The faults that are still to begin or end for one robot, and when.

    Args:
        planned: in any order; of two changes at the same time, the later in the list wins.
    """

    def __init__(self, planned: Sequence[PlannedFault] = ()) -> None:
        steps = [(fault.at_s, fault.changes) for fault in planned]
        ends = [(fault.until_s, fault.changes) for fault in planned if fault.until_s is not None]
        healthy = [(end_s, {name: getattr(HEALTHY, name) for name in changes}) for end_s, changes in ends]
        self._steps = sorted(healthy + steps, key=lambda step: step[0])  # at the same time, an end comes first

    @property
    def next_s(self) -> float:
        """The time of the next change; infinity for none."""
        return self._steps[0][0] if self._steps else math.inf

    def take_due(self, now_s: float) -> dict[str, Any]:
        """Return the changes up to a time, by name, and remove them from the plan."""
        changes: dict[str, Any] = {}
        while self.next_s <= now_s:
            changes |= self._steps.pop(0)[1]
        return changes
