"""Plans of formations, and the scenario step `plan_formation`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, TypedDict

from pydantic import ValidationError

from eal_actors.actors.combine import gather
from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.many import read_many
from eal_actors.device.navigation.traffic.lattice import Point
from eal_actors.device.world.model import Formation, formation_poses
from eal_actors.kernel.errors import ArgumentError, ScenarioError
from eal_actors.lab.choreography.phasing import plan_phases
from eal_actors.scenario.steps.python import StepContext

STRAY_M: Final = 0.05
"""Tolerated distance of a robot from its planned path or place."""


class FormationPlan(TypedDict):
    """A plan to form a shape.

    Attributes:
        phases: for each phase, each robot's position at its end, by name: [x_m, y_m].
        places: each robot's final pose, by name: [x_m, y_m, yaw_deg].
    """

    phases: list[dict[str, list[float]]]
    places: dict[str, list[float]]


def plan_shape(starts: Mapping[str, Point], rule: Formation, clearance_m: float) -> FormationPlan:
    """Plan how robots form a shape; each moves on straight paths.

    Args:
        starts: position of each robot, by name.
        rule: the shape, with one place for each robot.
        clearance_m: smallest distance between the centres of two robots at any time.

    Raises:
        ArgumentError: starts or places are closer than the clearance, or the robots block each other.
    """
    poses = formation_poses(rule)
    places = [(pose.x_m, pose.y_m) for pose in poses]
    names, points = list(starts), list(starts.values())
    steps, place_of = plan_phases(points, places, clearance_m)
    return {
        "phases": [
            {names[robot]: list(places[number] if number >= 0 else points[robot]) for robot, number in enumerate(phase)}
            for phase in steps
        ],
        "places": {
            name: [poses[number].x_m, poses[number].y_m, poses[number].yaw_deg]
            for name, number in zip(names, place_of, strict=True)
        },
    }


def clearance_m(radius_m: float, margin_m: float) -> float:
    """Return the planned distance between the centres of two robots that keeps the margin if both stray.

    Args:
        radius_m: radius of the largest robot.
        margin_m: smallest distance between the hulls.
    """
    return 2 * (radius_m + STRAY_M) + margin_m


def plan_formation(
    context: StepContext,
    *,
    shape: str,
    spacing_m: float,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_deg: float = 0.0,
    radius_m: float = 0.2,
    margin_m: float = 0.1,
) -> FormationPlan:
    """Plan how the robots of the scenario form a shape; the step belongs outside of `on`.

    Args:
        context: of the step. The robots' resource TruePose gives their positions.
        shape: line, column, grid, circle or wedge.
        spacing_m: distance between neighbours.
        x_m: centre of the shape, in the frame of TruePose.
        y_m: centre of the shape, in the frame of TruePose.
        yaw_deg: direction that the shape faces.
        radius_m: radius of the largest robot.
        margin_m: smallest distance between any two hulls, if no robot strays more than `STRAY_M`.

    Raises:
        ScenarioError: the shape is invalid, or the robots cannot form it.
        EALError: a robot's pose cannot be read.

    Thread: blocks the caller until the pose of every robot is known.
    """
    rule = _rule(shape=shape, count=len(context.robots), spacing_m=spacing_m, x_m=x_m, y_m=y_m, yaw_deg=yaw_deg)
    plan = _plan(_positions(context.robots), rule, clearance_m(radius_m, margin_m))
    number = len(plan["phases"])
    context.log(f"{rule.count} robots form a {shape} in {number} phase{'s' * (number != 1)}")
    return plan


def _rule(**wanted: object) -> Formation:
    try:
        return Formation.model_validate(wanted)
    except ValidationError as error:
        first = error.errors()[0]
        raise ScenarioError(f"invalid formation: {first['loc'][0]}: {first['msg']}") from None


def _positions(robots: Mapping[str, RobotHandle]) -> dict[str, Point]:
    """Return the position of every robot, read from all at once."""
    poses = gather(read_many([robot["TruePose"] for robot in robots.values()])).get()
    return {name: (float(pose.value[0]), float(pose.value[1])) for name, pose in zip(robots, poses, strict=True)}


def _plan(starts: Mapping[str, Point], rule: Formation, apart_m: float) -> FormationPlan:
    try:
        return plan_shape(starts, rule, apart_m)
    except ArgumentError as error:
        raise ScenarioError(f"the robots cannot form this {rule.shape}: {error.message}") from None
