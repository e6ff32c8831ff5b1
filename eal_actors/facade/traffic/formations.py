"""The goals of robots that take up the places of a shape."""

from __future__ import annotations

from collections.abc import Mapping

from pydantic import ValidationError

from eal_actors.device.localization.pose_estimate import Point
from eal_actors.device.navigation.assigning import assign_places
from eal_actors.device.world import Formation, formation_poses
from eal_actors.kernel.errors import ArgumentError
from eal_actors.kernel.strict_model import wording_of


def formation_goals(
    starts: Mapping[str, Point], shape: str, spacing_m: float, centre: tuple[float, float, float]
) -> dict[str, tuple[float, float, float]]:
    """Return the place of each robot in a shape, so that they drive little: x_m, y_m and yaw_deg.

    The robots start at `starts`, by name, in the map frame. `centre` is x_m, y_m and yaw_deg of the shape. Raises
    ArgumentError if there is no such shape, or a number is out of its range.
    """
    x_m, y_m, yaw_deg = centre
    wanted = {"shape": shape, "count": len(starts), "spacing_m": spacing_m, "x_m": x_m, "y_m": y_m, "yaw_deg": yaw_deg}
    try:
        poses = formation_poses(Formation.model_validate(wanted))
    except ValidationError as error:
        first = error.errors()[0]
        raise ArgumentError(f"invalid formation: {first['loc'][0]}: {wording_of(first)}") from None
    numbers = assign_places(list(starts.values()), [(pose.x_m, pose.y_m) for pose in poses])
    return {
        name: (poses[number].x_m, poses[number].y_m, poses[number].yaw_deg)
        for name, number in zip(starts, numbers, strict=True)
    }
