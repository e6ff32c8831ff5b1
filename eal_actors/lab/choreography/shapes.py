"""How robots form a shape: who goes to which place, and in which phase."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

from eal_actors.device.world.formation import Formation, formation_poses
from eal_actors.lab.choreography.assigning import Point
from eal_actors.lab.choreography.phasing import plan_phases


class FormationPlan(TypedDict):
    """What robots do to form a shape.

    Attributes:
        phases: for each phase where each robot is to be in the end of it, by name: [x_m, y_m].
        places: where each robot stands in the end, by name: [x_m, y_m, yaw_deg].
    """

    phases: list[dict[str, list[float]]]
    places: dict[str, list[float]]


def plan_shape(starts: Mapping[str, Point], rule: Formation, clearance_m: float) -> FormationPlan:
    """Plan how robots form a shape, each going straight from place to place.

    Args:
        starts: where each robot stands, by name.
        rule: the shape, with as many places as there are robots.
        clearance_m: least distance from the middle of a robot to the middle of another at any time.

    Raises:
        ArgumentError: they stand, or are wanted, nearer than the clearance, or find no way past each other.
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
