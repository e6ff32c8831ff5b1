"""The visual scene of a world: its fixed surfaces and the appearance of its moving objects."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from eal_actors.device.world import WorldModel

from . import baking
from .baking import TextureBaker
from .cutting import cut_out, without_overlaps
from .light import RoomLight
from .movers import BoxAt, BoxKit, Mover, RobotAppearance, RobotAt, RobotKit, box_shadow
from .patterns import albedo
from .solids import Block, Drum, Face, Plane, Point, Solid, Tower
from .texture import Mipmap
from .visibility import Faces

_MOST_SAMPLES: Final = 10e6  # of all fixed surfaces, at 4 bytes
_ROUND: Final = 24  # corners of a pillar's outline for shadows and cuts


class Scene:
    """The fixed surfaces of a world with their textures, and the appearance of its moving objects.

    Args:
        model: the world. The same world gives the same textures, everywhere.

    Attributes:
        light: how bright its surfaces are.
        walls: the four walls, seen from inside.
        blocks: the blocks that do not move; no two overlap.
        faces: the faces of the walls, of the posters, and of each block.

    Thread: any.
    """

    def __init__(self, model: WorldModel) -> None:
        self.light: Final = RoomLight(model)
        baker = TextureBaker(model, self.light, min(1.0, math.sqrt(_MOST_SAMPLES / _samples(model))))
        ends = _room_corners(model.size_m)
        self.walls: Final = tuple(
            baker.wall(left, right) for left, right in zip(ends, ends[1:] + ends[:1], strict=True)
        )
        self.posters: Final = tuple(_poster(baker, model, poster) for poster in model.posters)
        self.floor: Final = baker.floor(_outlines(model))
        self.ceiling: Final = baker.ceiling()
        self.blocks, self.towers = _solids(baker, model)
        self.faces: Final = Faces([self.walls, self.posters, *(block.faces for block in self.blocks)])
        self._boxes: Final = tuple(_box_kit(baker, model, box) for box in model.boxes)
        self._robots: dict[RobotAppearance, RobotKit] = {}

    def placed(self, movers: Sequence[Mover]) -> tuple[list[Solid], list[Plane]]:
        """Return the moving objects as solids, and their shadows on the floor."""
        if not movers:
            return [], []
        kits = [self._kit(mover) for mover in movers]
        places = [(mover.x_m, mover.y_m, kit.middle_m) for mover, kit in zip(movers, kits, strict=True)]
        gains = self.light.around(np.array(places))
        solids: list[Solid] = []
        shadows: list[Plane] = []
        for mover, kit, gain in zip(movers, kits, gains, strict=True):
            solids.append(kit.at(mover, gain))  # type: ignore[arg-type]  # each kind of mover has its kind of kit
            shadows.append(Plane(0.0, (mover.x_m, mover.y_m), mover.yaw_rad, kit.shadow))
        return solids, shadows

    def _kit(self, mover: Mover) -> RobotKit | BoxKit:
        if isinstance(mover, BoxAt):
            return self._boxes[mover.number]
        kit = self._robots.get(mover.appearance)
        return kit or self._robots.setdefault(mover.appearance, RobotKit.of(mover.appearance))


def _room_corners(size_m: tuple[float, float]) -> list[Point]:
    """Return the corners of the room, from left to right as seen from inside."""
    x_m, y_m = size_m[0] / 2, size_m[1] / 2
    return [(-x_m, y_m), (x_m, y_m), (x_m, -y_m), (-x_m, -y_m)]


_WALLS: Final = ("north", "east", "south", "west")


def _poster(baker: TextureBaker, model: WorldModel, poster: Any) -> Face:
    ends = _room_corners(model.size_m)
    number = _WALLS.index(poster.wall)
    left, right = ends[number], ends[(number + 1) % 4]
    axis = number % 2  # of the place along the wall
    sign = 1.0 if right[axis] > left[axis] else -1.0
    half_m = poster.size_m[0] / 2
    ends_m = poster.at_m - sign * half_m, poster.at_m + sign * half_m
    places = [(along_m, left[1]) if axis == 0 else (left[0], along_m) for along_m in ends_m]
    heights_m = poster.bottom_m, poster.bottom_m + poster.size_m[1]
    return baker.face(places[0], places[1], heights_m, poster.texture, baking.POSTER_PER_M)


def _solids(baker: TextureBaker, model: WorldModel) -> tuple[tuple[Block, ...], tuple[Tower, ...]]:
    blocks: list[Block] = []
    towers: list[Tower] = []
    for obstacle in model.solid_obstacles:
        if obstacle.kind == "box":
            blocks.append(_block(baker, obstacle))
        else:
            towers.append(_pillar(baker, model, obstacle, obstacle.texture))
    towers += [_pillar(baker, model, beacon, beacon.colour) for beacon in model.beacons]
    blocks = without_overlaps(blocks)
    for tower in towers:
        drum = tower.drums[0]
        blocks = cut_out(blocks, tuple(_round(drum.middle, drum.radius_m * 0.995, _ROUND)), drum.height_m)
    return tuple(blocks), tuple(towers)


def _block(baker: TextureBaker, obstacle: Any) -> Block:
    yaw_rad = math.radians(obstacle.yaw_deg)
    middle = obstacle.x_m, obstacle.y_m
    corners = tuple(_turned(corner, middle, yaw_rad) for corner in _rectangle(obstacle.size_m))
    edges = zip(corners, corners[1:] + corners[:1], strict=True)
    heights_m = 0.0, obstacle.height_m
    return Block(
        corners,
        obstacle.height_m,
        tuple(baker.face(left, right, heights_m, obstacle.texture, baking.SOLID_PER_M) for left, right in edges),
        baker.top(middle, obstacle.size_m, yaw_rad, obstacle.height_m, obstacle.texture),
    )


def _pillar(baker: TextureBaker, model: WorldModel, thing: Any, pattern: str | tuple[int, int, int] | None) -> Tower:
    """Return a round obstacle with a texture, or a beacon of a colour."""
    middle, radius_m, height_m = (thing.x_m, thing.y_m), thing.radius_m, thing.height_m
    canvas = baker.canvas((2 * math.pi * radius_m, height_m), baking.SOLID_PER_M, wraps=True)
    top = baker.top(middle, (2 * radius_m, 2 * radius_m), 0.0, height_m, pattern if isinstance(pattern, str) else None)
    if isinstance(pattern, tuple):
        colours = np.empty((canvas.rows, canvas.columns, 3), np.float32)
        colours[:] = pattern
        bands = (canvas.up_m[:, 0] / 0.2) % 1.0 < 0.3
        colours[bands] = 235
    else:
        colours = albedo(model, pattern, canvas)
    side = baker.side(middle, radius_m, height_m, colours, canvas)
    return Tower((Drum(middle, radius_m, 0.0, height_m, 0.0, side, top),))


def _box_kit(baker: TextureBaker, model: WorldModel, box: Any) -> BoxKit:
    corners = tuple(_rectangle(box.size_m))
    faces = []
    for left, right in zip(corners, corners[1:] + corners[:1], strict=True):
        faces.append(
            Face(left, right, 0.0, box.height_m, _unlit(baker, model, box, (math.dist(left, right), box.height_m)))
        )
    top = Plane(box.height_m, (0.0, 0.0), 0.0, _unlit(baker, model, box, box.size_m))
    return BoxKit(Block(corners, box.height_m, tuple(faces), top), box_shadow(box.size_m))


def _unlit(baker: TextureBaker, model: WorldModel, box: Any, size_m: tuple[float, float]) -> Mipmap:
    """Return one side of a movable box, a little darker at its edges."""
    canvas = baker.canvas(size_m, baking.SOLID_PER_M)
    from_edge_m = np.minimum(
        np.minimum(canvas.along_m, size_m[0] - canvas.along_m), np.minimum(canvas.up_m, size_m[1] - canvas.up_m)
    )
    dark = 1 - 0.25 * np.exp(-from_edge_m / 0.012)
    return Mipmap(baking.lit(albedo(model, box.texture, canvas), np.ones((1, 1)), dark), size_m)


def _outlines(model: WorldModel) -> list[tuple[list[Point], float]]:
    """Return corners and height of each fixed object on the floor."""
    outlines = []
    for thing in (*model.solid_obstacles, *model.beacons):
        middle = thing.x_m, thing.y_m
        if hasattr(thing, "radius_m"):
            outlines.append((_round(middle, thing.radius_m, _ROUND), thing.height_m))
        else:
            yaw_rad = math.radians(thing.yaw_deg)
            outlines.append(([_turned(c, middle, yaw_rad) for c in _rectangle(thing.size_m)], thing.height_m))
    return outlines


def _rectangle(size_m: tuple[float, float]) -> list[Point]:
    x_m, y_m = size_m[0] / 2, size_m[1] / 2
    return [(-x_m, -y_m), (x_m, -y_m), (x_m, y_m), (-x_m, y_m)]


def _round(middle: Point, radius_m: float, count: int) -> list[Point]:
    turns = [2 * math.pi * number / count for number in range(count)]
    return [(middle[0] + radius_m * math.cos(turn), middle[1] + radius_m * math.sin(turn)) for turn in turns]


def _turned(point: Point, middle: Point, yaw_rad: float) -> Point:
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    return middle[0] + cos * point[0] - sin * point[1], middle[1] + sin * point[0] + cos * point[1]


def _samples(model: WorldModel) -> float:
    """Return the approximate number of samples of a world's textures in full detail."""
    (x_m, y_m), up_m = model.size_m, model.height_m
    total = (
        x_m * y_m * (baking.FLOOR_PER_M**2 + baking.CEILING_PER_M**2) + 2 * (x_m + y_m) * up_m * baking.WALL_PER_M**2
    )
    total += sum(math.prod(poster.size_m) for poster in model.posters) * baking.POSTER_PER_M**2
    for corners, height_m in _outlines(model):
        around_m = sum(math.dist(corner, corners[number - 1]) for number, corner in enumerate(corners))
        total += around_m * height_m * baking.SOLID_PER_M**2
    return total


__all__ = ["BoxAt", "Mover", "RobotAppearance", "RobotAt", "Scene"]
