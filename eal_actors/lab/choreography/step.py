"""The scenario step `plan_formation`: which robot goes to which place of a shape, and in which phase."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, Protocol

from pydantic import ValidationError

from eal_actors.actors.combine import gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.world.formation import Formation
from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.choreography.assigning import Point
from eal_actors.lab.choreography.shapes import FormationPlan, plan_shape

STRAY_M: Final = 0.05
"""How far a robot may be from where it is planned to be: off its way, or off its place."""


class Context(Protocol):
    """What the step uses of its scenario."""

    @property
    def robots(self) -> Mapping[str, RobotHandle]:
        """The robots that take part, by name."""
        ...

    @property
    def log(self) -> Callable[[str], None]:
        """Tells those who watch."""
        ...


def clearance_m(radius_m: float, margin_m: float) -> float:
    """Return how far apart the middles of two robots are planned to be, so that the margin is left if both stray.

    Args:
        radius_m: of the largest robot.
        margin_m: wanted between the hulls.
    """
    return 2 * (radius_m + STRAY_M) + margin_m


def plan_formation(
    context: Context,
    *,
    shape: str,
    spacing_m: float,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_deg: float = 0.0,
    radius_m: float = 0.2,
    margin_m: float = 0.1,
) -> FormationPlan:
    """Plan how the robots that take part form a shape; stands outside an `on`.

    Args:
        context: of the step. Where the robots stand is asked of their Pose.
        shape: line, column, grid, circle or wedge.
        spacing_m: from each robot to its neighbours.
        x_m: middle of the shape, in the frame of Pose.
        y_m: middle of the shape, in the frame of Pose.
        yaw_deg: the way the shape faces.
        radius_m: of the largest robot.
        margin_m: least distance between any two hulls at any time, if nobody strays more than `STRAY_M`.

    Raises:
        ScenarioError: there is no such shape, or the robots cannot form it so.
        EALError: a robot does not tell where it is.

    Thread: blocks the caller until every robot has told where it is.
    """
    rule = _rule(shape=shape, count=len(context.robots), spacing_m=spacing_m, x_m=x_m, y_m=y_m, yaw_deg=yaw_deg)
    plan = _plan(_places(context.robots), rule, clearance_m(radius_m, margin_m))
    number = len(plan["phases"])
    context.log(f"{rule.count} robots form a {shape} in {number} phase{'s' * (number != 1)}")
    return plan


def _rule(**wanted: object) -> Formation:
    try:
        return Formation.model_validate(wanted)
    except ValidationError as error:
        first = error.errors()[0]
        raise ScenarioError(f"there is no such formation: {first['loc'][0]}: {first['msg']}") from None


def _places(robots: Mapping[str, RobotHandle]) -> dict[str, Point]:
    """Ask every robot at once where it is."""
    poses = gather([robot["Pose"].get_value() for robot in robots.values()]).get()
    return {name: (float(pose.value[0]), float(pose.value[1])) for name, pose in zip(robots, poses, strict=True)}


def _plan(starts: Mapping[str, Point], rule: Formation, apart_m: float) -> FormationPlan:
    try:
        return plan_shape(starts, rule, apart_m)
    except ArgumentError as error:
        raise ScenarioError(f"the robots cannot form this {rule.shape}: {error.message}") from None
