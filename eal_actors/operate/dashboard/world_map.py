"""The simulated world as shapes that the page's map draws."""

from __future__ import annotations

from itertools import chain
from typing import Any

from eal_actors.device.world import BoxObstacle, CircleObstacle, Drop, MovableBox, WorldModel


def world_map(world: WorldModel | None) -> dict[str, Any] | None:
    """Return the walls and the initial obstacles; None without a world file.

    Coordinates are metres in the world's frame, angles degrees, colours red, green and blue of 0..255.
    """
    if world is None:
        return None
    return {
        "name": world.name,
        "size_m": list(world.size_m),
        "shapes": [
            *(_box("drop", drop) for drop in world.drops),
            *(_obstacle(obstacle) for obstacle in world.solid_obstacles),
            *(_box("box", box, name=box.name) for box in world.boxes),
        ],
        "posters": [list(chain(*poster.ends_m(world.size_m))) for poster in world.posters],
        "keep_out": [list(zone) for zone in world.keep_out],
        "places": [{"x_m": place.x_m, "y_m": place.y_m, "name": name} for name, place in world.places.items()],
        "beacons": [
            {"x_m": beacon.x_m, "y_m": beacon.y_m, "name": beacon.name, "colour": list(beacon.colour)}
            for beacon in world.beacons
        ],
    }


def _obstacle(obstacle: BoxObstacle | CircleObstacle) -> dict[str, Any]:
    if isinstance(obstacle, CircleObstacle):
        return {"kind": "obstacle", "x_m": obstacle.x_m, "y_m": obstacle.y_m, "radius_m": obstacle.radius_m}
    return _box("obstacle", obstacle)


def _box(kind: str, box: BoxObstacle | MovableBox | Drop, **more: str) -> dict[str, Any]:
    place = {"x_m": box.x_m, "y_m": box.y_m, "size_m": list(box.size_m), "yaw_deg": box.yaw_deg}
    return {"kind": kind, **place, **more}
