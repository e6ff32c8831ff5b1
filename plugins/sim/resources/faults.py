"""The resource that injects faults, by call and by plan."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    Clock,
    ConfigInfo,
    DataType,
    EALData,
    Link,
    ResourceInfo,
    ResourceType,
    ValueInfo,
    command,
)

from ..faults import HEALTHY, FaultPlan, FaultSet
from ..robot import SimRobot
from ..world import SimWorld
from .robot_resource import RobotResource

_NAMES: Final = ("frozen", "failing")
"""The faults that name resources."""
_UNITS: Final = {"link_delay_s": "s"}


def _value_info(name: str, default: object, limits: Sequence[Any]) -> ValueInfo:
    if isinstance(default, bool):
        return ValueInfo(DataType.BOOL)
    if name in _NAMES:
        return ValueInfo(DataType.CHAR, description="names, separated by commas; empty for none")
    bounds = {bound: getattr(limit, bound) for limit in limits for bound in ("ge", "le") if hasattr(limit, bound)}
    unit = _UNITS.get(name)
    return ValueInfo(DataType.DOUBLE, unit, bounds["ge"], bounds["le"], description="" if unit else "a share")


_CONFIGS: Final = tuple(
    ConfigInfo(name, _value_info(name, field.default, field.metadata), description=field.description or "")
    for name, field in FaultSet.model_fields.items()
)


class Faults(RobotResource):
    """Injects faults into the robot; get_status: 0 healthy, 1 faulty.

    It is not part of the robot: it answers over a cut link, and when the robot is dead.

    Args:
        link: the simulated link between controllers and the robot.
        clock: the fleet's clock, which the plan follows.
        resources: the robot's resources that can freeze or fail, by fault.
    """

    types = ResourceType.OTHER
    value = ValueInfo(DataType.CHAR, description="JSON object of the present faults")

    def __init__(
        self,
        world: SimWorld,
        robot: SimRobot,
        link: Link,
        plan: FaultPlan,
        clock: Clock,
        resources: Mapping[str, Sequence[str]],
    ) -> None:
        super().__init__(world, robot)
        self._link = link
        self._plan = plan
        self._clock = clock
        self._resources = resources

    def info(self) -> ResourceInfo:
        """Return its description, with each fault as a configuration key."""
        return replace(super().info(), configs=_CONFIGS)

    def background(self) -> Activity | None:
        """Carry out the plan."""
        return self._carry_out() if self._plan.next_s < math.inf else None

    def get_status(self) -> int:
        """Return 0 while the robot is healthy, 1 while it has a fault."""
        return int(bool(self._robot.faults.present))

    def get_value(self) -> EALData:
        """Return the present faults as a JSON object, such as `{"motor_left": 0.5}`."""
        return EALData.of(json.dumps(self._robot.faults.present), stamp_s=self._clock.now())

    @override
    def get_config(self, key: str) -> EALData:
        name = self.info().config(key).name
        value = getattr(self._robot.faults, name)
        return EALData.of(",".join(value) if name in _NAMES else value)

    @override
    def set_config(self, key: str, data: EALData | None = None) -> None:
        info = self.info().config(key)
        value = info.checked(data).value
        if info.name in _NAMES:
            value = self._parse_names(info.name, value)
        elif info.value.type is DataType.DOUBLE:
            value = float(value)
        self._apply({key: value})

    @command("clear", repeatable=True)
    def clear(self) -> None:
        """End all faults; planned faults still begin."""
        self._apply(HEALTHY.model_dump())

    def _carry_out(self) -> Activity:
        while True:
            now_s = self._clock.now()
            if self._plan.next_s <= now_s:
                self._apply(self._plan.take_due(now_s))
            if self._plan.next_s == math.inf:
                return
            yield self._plan.next_s - now_s

    def _apply(self, changes: dict[str, Any]) -> None:
        with self._world.lock:
            self._world.catch_up()
            faults = self._robot.faults = self._robot.faults.model_copy(update=changes)
            if faults.dead or faults.battery_empty or "Base" in faults.failing:
                self._world.stop(self._robot)
            if faults.dead and self._robot.turret:
                self._robot.turret.stop()
        self._link.impair(delay_s=faults.link_delay_s, loss=faults.link_loss, is_cut=faults.link_cut or faults.dead)

    def _parse_names(self, fault: str, text: str) -> tuple[str, ...]:
        names = tuple(name.strip() for name in text.split(",") if name.strip())
        for name in names:
            if name not in self._resources[fault]:
                raise ArgumentError(
                    f"robot {self._robot.name!r} has no resource {name!r} that can be {fault}; "
                    f"use: {', '.join(self._resources[fault])}"
                )
        return names
