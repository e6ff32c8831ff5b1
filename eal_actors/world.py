"""A simulated arena: a walled rectangle and what stands in it, as a world file describes it.

The frame of a world: the origin is the middle of the floor, x points right, y points up on the plan, z points up from
the floor, yaw turns counter-clockwise from the x axis. Lengths are metres; angles are degrees, as the `_deg` in their
names says. North is +y, east is +x.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, NonNegativeFloat, PositiveFloat, PositiveInt, ValidationError, model_validator

from eal_actors.errors import ConfigError
from eal_actors.strict_model import NAMES_ONLY, Name, StrictModel, Version1, did_you_mean, problems_from
from eal_actors.yaml_source import load_yaml
from eal_actors.yaml_tree import YamlPath

Channel = Annotated[int, Field(ge=0, le=255)]
Colour = Annotated[tuple[Channel, Channel, Channel], Field(strict=False)]
"""Red, green and blue."""

Degrees = Annotated[float, Field(ge=-360, le=360)]


class Texture(StrictModel):
    """What a surface looks like: a pattern drawn from its colours and the world's seed."""

    pattern: Literal["plain", "checker", "stripes", "planks", "bricks", "plaster", "mosaic", "poster"]
    """`plaster` is rough, `mosaic` and `poster` are rich in features: each place on them looks different."""
    colours: tuple[Colour, ...] = Field(default=((200, 200, 200),), min_length=1, strict=False)
    """The first is the ground."""
    tile_m: PositiveFloat = 0.5
    """Size of a tile, plank, brick or stripe."""


class Surfaces(StrictModel):
    """The textures of the room, by their names in `textures`; without one, a plain grey."""

    floor: Name | None = None
    walls: Name | None = None
    ceiling: Name | None = None


class Poster(StrictModel):
    """A picture on one of the four walls."""

    wall: Literal["north", "east", "south", "west"]
    at_m: float
    """Middle of the poster along the wall: its x on the north and south walls, its y on the others."""
    bottom_m: NonNegativeFloat = 0.5
    """Height of its lower edge over the floor."""
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(default=(1.0, 0.7), strict=False)
    """Width and height."""
    texture: Name


class Placed(StrictModel):
    """What has a place on the floor."""

    x_m: float
    """Middle of it."""
    y_m: float
    """Middle of it."""


class Obstacle(Placed):
    """What stands in the way and cannot be moved."""

    height_m: PositiveFloat = 0.8
    """From the floor to its top."""
    texture: Name | None = None


class BoxObstacle(Obstacle):
    """A rectangular block, turned by `yaw_deg` about its middle."""

    kind: Literal["box"]
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Extent along its own x axis and its own y axis."""
    yaw_deg: Degrees = 0.0
    """Turn of its own x axis, counter-clockwise."""


class CircleObstacle(Obstacle):
    """A round pillar."""

    kind: Literal["circle"]
    radius_m: PositiveFloat


class Partition(StrictModel):
    """A thin inner wall between two points."""

    kind: Literal["wall"]
    start_m: tuple[float, float] = Field(strict=False)
    """x and y of one end."""
    end_m: tuple[float, float] = Field(strict=False)
    """x and y of the other end."""
    thickness_m: PositiveFloat = 0.1
    height_m: PositiveFloat = 0.8
    texture: Name | None = None

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if self.start_m == self.end_m:
            raise ValueError("start_m and end_m are the same point")
        return self

    def as_box(self) -> BoxObstacle:
        """Return the block that it is."""
        (x0, y0), (x1, y1) = self.start_m, self.end_m
        return BoxObstacle(
            kind="box",
            x_m=(x0 + x1) / 2,
            y_m=(y0 + y1) / 2,
            size_m=(math.hypot(x1 - x0, y1 - y0), self.thickness_m),
            yaw_deg=math.degrees(math.atan2(y1 - y0, x1 - x0)),
            height_m=self.height_m,
            texture=self.texture,
        )


AnyObstacle = Annotated[BoxObstacle | CircleObstacle | Partition, Field(discriminator="kind")]


class MovableBox(Placed):
    """A box that robots can push over the floor."""

    name: Name
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(default=(0.3, 0.3), strict=False)
    """Extent along its own x axis and its own y axis."""
    height_m: PositiveFloat = 0.3
    yaw_deg: Degrees = 0.0
    mass_kg: PositiveFloat = 1.0
    friction: PositiveFloat = 0.3
    """Between it and the floor: over its weight, the force that it takes to push it."""
    texture: Name | None = None


class Light(Placed):
    """A lamp that shines evenly to all sides."""

    z_m: PositiveFloat = 2.4
    lumens: PositiveFloat = 800.0


class Lighting(StrictModel):
    """What lights the room for cameras and light sensors."""

    ambient_lux: NonNegativeFloat = 150.0
    """Light that comes evenly from everywhere, such as daylight."""
    lamps: tuple[Light, ...] = Field(default=(), strict=False)


class Beacon(Placed):
    """A post that robots see by its colour and find by its signal."""

    name: Name
    radius_m: PositiveFloat = 0.05
    height_m: PositiveFloat = 1.0
    colour: Colour = (230, 40, 40)
    reach_m: PositiveFloat = 6.0
    """How far its signal carries; obstacles block it, robots do not."""


class Drop(Placed):
    """A hole in the floor, such as a stairwell: cliff sensors see it, and a wheel over it drops."""

    size_m: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Extent along its own x axis and its own y axis."""
    yaw_deg: Degrees = 0.0


class StartPose(Placed):
    """Where a robot may stand at first."""

    yaw_deg: Degrees = 0.0


class Formation(Placed):
    """Start poses for many robots, made by a rule; see `formation_poses` for each shape."""

    shape: Literal["line", "column", "grid", "circle", "wedge"]
    count: PositiveInt
    spacing_m: PositiveFloat
    """From each robot to its neighbours."""
    x_m: float = 0.0
    """Middle of the formation."""
    y_m: float = 0.0
    """Middle of the formation."""
    yaw_deg: Degrees = 0.0
    """Where the formation, and each robot in it, faces; in a circle they face outwards, the first this way."""


class Physics(StrictModel):
    """How the arena is simulated."""

    rate_hz: float = Field(default=50.0, gt=0, le=1000)
    """Steps in a second of the fleet's clock."""


class WorldModel(StrictModel):
    """A world file."""

    version: Version1
    name: Name
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Extent along x and along y, between the walls."""
    height_m: PositiveFloat = 2.5
    """From the floor to the ceiling."""
    seed: int = Field(default=0, ge=0)
    """Of whatever the world itself draws by lot, such as the patterns of textures. Robots follow the fleet's seed."""
    textures: dict[Name, Texture] = Field(default={}, json_schema_extra=NAMES_ONLY)
    surfaces: Surfaces = Surfaces()
    posters: tuple[Poster, ...] = Field(default=(), strict=False)
    obstacles: tuple[AnyObstacle, ...] = Field(default=(), strict=False)
    boxes: tuple[MovableBox, ...] = Field(default=(), strict=False)
    beacons: tuple[Beacon, ...] = Field(default=(), strict=False)
    drops: tuple[Drop, ...] = Field(default=(), strict=False)
    lighting: Lighting = Lighting()
    starts: Annotated[tuple[StartPose, ...], Field(strict=False)] | Formation = ()
    """Places for the robots that name none themselves, given in the order of the robots' names."""
    physics: Physics = Physics()

    @property
    def solid_obstacles(self) -> tuple[BoxObstacle | CircleObstacle, ...]:
        """The obstacles, partitions as the blocks that they are."""
        return tuple(part.as_box() if isinstance(part, Partition) else part for part in self.obstacles)

    @property
    def start_poses(self) -> tuple[StartPose, ...]:
        """The start poses, a formation as the poses that it means."""
        return formation_poses(self.starts) if isinstance(self.starts, Formation) else self.starts


def formation_poses(formation: Formation) -> tuple[StartPose, ...]:
    """Return the start poses of a formation, rounded to the micrometre.

    A `line` is abreast, the first on the left; a `column` is one behind the other, the first in front; a `grid` has
    as many rows as columns or one less, the first robot at the front left; a `circle` goes counter-clockwise from the
    way the formation faces; a `wedge` is a V whose point is the first robot, then left and right by turns.
    """
    places = _SHAPES[formation.shape](formation.count, formation.spacing_m)
    middle_x, middle_y = (sum(place[axis] for place in places) / len(places) for axis in range(2))
    yaw_rad = math.radians(formation.yaw_deg)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    poses = []
    for ahead, left, turn_deg in places:
        ahead, left = ahead - middle_x, left - middle_y
        poses.append(
            StartPose(
                x_m=round(formation.x_m + cos * ahead - sin * left, 6),
                y_m=round(formation.y_m + sin * ahead + cos * left, 6),
                yaw_deg=round(math.remainder(formation.yaw_deg + turn_deg, 360.0), 6),
            )
        )
    return tuple(poses)


_Places = list[tuple[float, float, float]]  # metres ahead, metres to the left, degrees turned to the left


def _line(count: int, spacing_m: float) -> _Places:
    return [(0.0, -number * spacing_m, 0.0) for number in range(count)]


def _column(count: int, spacing_m: float) -> _Places:
    return [(-number * spacing_m, 0.0, 0.0) for number in range(count)]


def _grid(count: int, spacing_m: float) -> _Places:
    columns = math.ceil(math.sqrt(count))
    return [(-(number // columns) * spacing_m, -(number % columns) * spacing_m, 0.0) for number in range(count)]


def _circle(count: int, spacing_m: float) -> _Places:
    radius_m = spacing_m / (2 * math.sin(math.pi / count)) if count > 1 else 0.0
    turns = [2 * math.pi * number / count for number in range(count)]
    return [(radius_m * math.cos(turn), radius_m * math.sin(turn), math.degrees(turn)) for turn in turns]


def _wedge(count: int, spacing_m: float) -> _Places:
    step_m = spacing_m / math.sqrt(2)
    ranks = [(number + 1) // 2 for number in range(count)]
    return [(-rank * step_m, rank * step_m * (1 if number % 2 else -1), 0.0) for number, rank in enumerate(ranks)]


_SHAPES = {"line": _line, "column": _column, "grid": _grid, "circle": _circle, "wedge": _wedge}


def load_world(path: str | Path) -> WorldModel:
    """Read a world file. The environment has no say in it: a world is the same on every machine.

    Raises:
        ConfigError: with every problem of the file.
    """
    tree = load_yaml(path)
    try:
        world = WorldModel.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, WorldModel)) from None
    if problems := [tree.problem(path, message) for path, message in _contradictions(world)]:
        raise ConfigError(sorted(problems))
    return world


def _contradictions(world: WorldModel) -> Iterable[tuple[YamlPath, str]]:
    """Find what each part allows but the whole does not."""
    yield from _unknown_textures(world)
    yield from _outside(world)
    for kind, things in (("boxes", world.boxes), ("beacons", world.beacons)):
        names = [thing.name for thing in things]
        for number, name in enumerate(names):
            if name in names[:number]:
                yield (kind, number, "name"), f"there are two of the name {name!r}"


def _unknown_textures(world: WorldModel) -> Iterable[tuple[YamlPath, str]]:
    used: list[tuple[YamlPath, str | None]] = [
        (("surfaces", part), getattr(world.surfaces, part)) for part in ("floor", "walls", "ceiling")
    ]
    for kind, things in (("posters", world.posters), ("obstacles", world.obstacles), ("boxes", world.boxes)):
        used += [((kind, number, "texture"), thing.texture) for number, thing in enumerate(things)]
    for path, name in used:
        if name is not None and name not in world.textures:
            yield path, f"no texture {name!r} in textures{did_you_mean(name, world.textures)}"


def _outside(world: WorldModel) -> Iterable[tuple[YamlPath, str]]:
    half_x, half_y = world.size_m[0] / 2, world.size_m[1] / 2
    room = f"the room, which reaches from {-half_x:g} to {half_x:g} m in x and from {-half_y:g} to {half_y:g} m in y"
    groups = (
        ("obstacles", [thing for thing in world.solid_obstacles]),
        ("boxes", world.boxes),
        ("beacons", world.beacons),
        ("drops", world.drops),
    )
    for kind, things in groups:
        for number, thing in enumerate(things):
            if abs(thing.x_m) > half_x or abs(thing.y_m) > half_y:
                yield (kind, number), f"its middle is outside {room}"
    for number, lamp in enumerate(world.lighting.lamps):
        if abs(lamp.x_m) > half_x or abs(lamp.y_m) > half_y or lamp.z_m > world.height_m:
            yield ("lighting", "lamps", number), f"it is outside {room} and is {world.height_m:g} m high"
    for number, pose in enumerate(world.start_poses):
        if abs(pose.x_m) > half_x or abs(pose.y_m) > half_y:
            if isinstance(world.starts, Formation):
                yield ("starts",), f"place {number + 1} of the formation, x {pose.x_m:g} m, y {pose.y_m:g} m, is outside {room}"
                return
            yield ("starts", number), f"it is outside {room}"
    for number, poster in enumerate(world.posters):
        length_m = world.size_m[0 if poster.wall in ("north", "south") else 1]
        if abs(poster.at_m) + poster.size_m[0] / 2 > length_m / 2 + 1e-9:
            yield ("posters", number), f"it does not fit on the {poster.wall} wall, which is {length_m:g} m long"
        if poster.bottom_m + poster.size_m[1] > world.height_m + 1e-9:
            yield ("posters", number), f"it does not fit under the ceiling, which is {world.height_m:g} m high"
