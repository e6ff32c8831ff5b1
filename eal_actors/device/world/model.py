"""The model of a world file and of its parts."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Final, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, NonNegativeFloat, PositiveFloat, Tag, model_validator

from eal_actors.device.world.overhead import OverheadCamera, WorldMarkers
from eal_actors.kernel.errors import PlaceNotFoundError
from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1
from eal_actors.kernel.suggestions import nearest

Channel = Annotated[int, Field(ge=0, le=255)]
Colour = Annotated[tuple[Channel, Channel, Channel], Field(strict=False)]
"""Red, green and blue."""


def _has_colours(colours: tuple[Colour, ...]) -> tuple[Colour, ...]:
    if not colours:
        raise ValueError("needs at least one colour")
    return colours


# Not by `min_length`, which counts only valid ones: an invalid colour would be reported as missing too.
Palette = Annotated[
    tuple[Colour, ...], Field(strict=False, json_schema_extra={"minItems": 1}), AfterValidator(_has_colours)
]
"""One colour or more."""

_MOST: Final = 1000
"""The most things of one kind that are compared with one another, and corners of a zone."""

_SHORTEST_M: Final = 0.001
Length = Annotated[float, Field(ge=_SHORTEST_M, le=10_000)]
"""Metres that simulations and pictures can show: others end in numbers that no float holds."""

Degrees = Annotated[float, Field(ge=-360, le=360)]


class SurfaceTexture(StrictModel):
    """The appearance of a surface: a pattern drawn from its colours and the world's seed."""

    pattern: Literal["plain", "checker", "stripes", "planks", "bricks", "plaster", "mosaic", "poster"]
    """`plaster` is rough, `mosaic` and `poster` are rich in features: each place on them looks different."""
    colours: Palette = ((200, 200, 200),)
    """The first is the background."""
    tile_m: Length = 0.5
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
    size_m: tuple[Length, Length] = Field(default=(1.0, 0.7), strict=False)
    """Width and height."""
    texture: Name

    def ends_m(self, room_m: tuple[float, float]) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return x and y of its two ends, in a room of a width and depth."""
        left_m, right_m = self.at_m - self.size_m[0] / 2, self.at_m + self.size_m[0] / 2
        sign = 1 if self.wall in ("north", "east") else -1
        if self.wall in ("north", "south"):
            return (left_m, sign * room_m[1] / 2), (right_m, sign * room_m[1] / 2)
        return (sign * room_m[0] / 2, left_m), (sign * room_m[0] / 2, right_m)


class FloorItem(StrictModel):
    """A thing with a place on the floor."""

    x_m: float
    """Its centre."""
    y_m: float
    """Its centre."""


class Obstacle(FloorItem):
    """An obstacle that cannot be moved."""

    height_m: Length = 0.8
    """From the floor to its top."""
    texture: Name | None = None


class BoxObstacle(Obstacle):
    """A rectangular block, turned by `yaw_deg` about its middle."""

    kind: Literal["box"]
    size_m: tuple[Length, Length] = Field(strict=False)
    """Extent along its own x axis and its own y axis."""
    yaw_deg: Degrees = 0.0
    """Turn of its own x axis, counter-clockwise."""


class CircleObstacle(Obstacle):
    """A round pillar."""

    kind: Literal["circle"]
    radius_m: Length


class Partition(StrictModel):
    """A thin inner wall between two points."""

    kind: Literal["wall"]
    start_m: tuple[float, float] = Field(strict=False)
    """x and y of one end."""
    end_m: tuple[float, float] = Field(strict=False)
    """x and y of the other end."""
    thickness_m: Length = 0.1
    height_m: Length = 0.8
    texture: Name | None = None

    @model_validator(mode="after")
    def _has_length(self) -> Self:
        if math.dist(self.start_m, self.end_m) < _SHORTEST_M:
            raise ValueError("start_m and end_m are the same point")
        return self

    def as_box(self) -> BoxObstacle:
        """Return it as a block."""
        (x0, y0), (x1, y1) = self.start_m, self.end_m
        return BoxObstacle.model_construct(  # unchecked: a diagonal may be longer than a room
            kind="box",
            x_m=(x0 + x1) / 2,
            y_m=(y0 + y1) / 2,
            size_m=(math.hypot(x1 - x0, y1 - y0), self.thickness_m),
            yaw_deg=math.degrees(math.atan2(y1 - y0, x1 - x0)),
            height_m=self.height_m,
            texture=self.texture,
        )


AnyObstacle = Annotated[BoxObstacle | CircleObstacle | Partition, Field(discriminator="kind")]


class MovableBox(FloorItem):
    """A box that robots can push over the floor."""

    name: Name
    size_m: tuple[Length, Length] = Field(default=(0.3, 0.3), strict=False)
    """Extent along its own x axis and its own y axis."""
    height_m: Length = 0.3
    yaw_deg: Degrees = 0.0
    mass_kg: PositiveFloat = 1.0
    friction: PositiveFloat = 0.3
    """Coefficient of friction on the floor: pushing force over weight."""
    texture: Name | None = None


class Lamp(FloorItem):
    """A lamp that shines evenly to all sides."""

    z_m: PositiveFloat = 2.4
    lumens: PositiveFloat = 800.0


class Lighting(StrictModel):
    """The light in the room, for cameras and light sensors."""

    ambient_lux: NonNegativeFloat = 150.0
    """Light that comes evenly from everywhere, such as daylight."""
    lamps: tuple[Lamp, ...] = Field(default=(), strict=False)


class Beacon(FloorItem):
    """A post that robots see by its colour and find by its signal."""

    name: Name
    radius_m: Length = 0.05
    height_m: Length = 1.0
    colour: Colour = (230, 40, 40)
    reach_m: PositiveFloat = 6.0
    """How far its signal carries; obstacles block it, robots do not."""


class Drop(FloorItem):
    """A hole in the floor, such as a stairwell: cliff sensors see it, and a wheel over it drops."""

    size_m: tuple[Length, Length] = Field(strict=False)
    """Extent along its own x axis and its own y axis."""
    yaw_deg: Degrees = 0.0


class NamedPlace(FloorItem):
    """A place with a name, to send robots to."""

    yaw_deg: Degrees | None = None
    """The heading of a robot there; any if left out."""


FloorPoint = Annotated[tuple[float, float], Field(strict=False)]
"""x and y."""
KeepOutZone = Annotated[tuple[FloorPoint, ...], Field(strict=False, min_length=3, max_length=_MOST)]
"""The corners of a polygon on the floor, in order; its edges must not cross."""


class StartPose(FloorItem):
    """The pose of a robot at the start."""

    yaw_deg: Degrees = 0.0
    """Its heading."""

    @model_validator(mode="before")
    @classmethod
    def _refuse_formation(cls, value: Any) -> Any:
        if isinstance(value, Mapping) and "shape" in value:
            raise ValueError("is a formation; write it without a list: `starts: {shape: ...}`")
        return value


class Physics(StrictModel):
    """The settings of the physics simulation."""

    rate_hz: float = Field(default=50.0, ge=5, le=1000)
    """Steps in a second of the fleet's clock. In a step of half a second, a robot would pass a thin wall."""


MAX_PLACES: Final = 10_000


class Formation(FloorItem):
    """Start poses of many robots by a rule; see `formation_poses` for each shape."""

    shape: Literal["line", "column", "grid", "circle", "wedge"]
    count: int = Field(ge=1, le=MAX_PLACES)
    """Number of places."""
    spacing_m: Length
    """Distance between neighbours."""
    x_m: float = 0.0
    """Centre of the formation: the mean of its places."""
    y_m: float = 0.0
    """Centre of the formation: the mean of its places."""
    yaw_deg: Degrees = 0.0
    """Heading of the formation and of each robot in it; in a circle they face outwards, the first this way."""


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


def _form_of_starts(value: object) -> str | None:
    """Return the form of `starts`, so that only errors of the intended form are reported."""
    if isinstance(value, Mapping | Formation):
        return "formation"
    return "poses" if isinstance(value, list | tuple) else None


Starts = Annotated[
    Annotated[tuple[StartPose, ...], Field(strict=False), Tag("poses")] | Annotated[Formation, Tag("formation")],
    Discriminator(
        _form_of_starts,
        custom_error_type="starts_form",
        custom_error_message="must be a list of start poses, or a formation: a mapping with shape, count and spacing_m",
    ),
]


class WorldModel(StrictModel):
    """A world file."""

    version: Version1
    name: Name
    size_m: tuple[Length, Length] = Field(strict=False)
    """Extent along x and along y, between the walls."""
    height_m: Length = 2.5
    """From the floor to the ceiling."""
    seed: int = Field(default=0, ge=0)
    """Seed of the world's own random choices, such as the patterns of textures. Robots use the fleet's seed."""
    textures: dict[Name, SurfaceTexture] = Field(default={}, json_schema_extra=NAMES_ONLY)
    surfaces: Surfaces = Surfaces()
    posters: tuple[Poster, ...] = Field(default=(), strict=False, max_length=_MOST)
    obstacles: tuple[AnyObstacle, ...] = Field(default=(), strict=False, max_length=_MOST)
    boxes: tuple[MovableBox, ...] = Field(default=(), strict=False, max_length=_MOST)
    beacons: tuple[Beacon, ...] = Field(default=(), strict=False, max_length=_MOST)
    drops: tuple[Drop, ...] = Field(default=(), strict=False, max_length=_MOST)
    places: dict[Name, NamedPlace] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Places by name, for programs and scenarios."""
    keep_out: tuple[KeepOutZone, ...] = Field(default=(), strict=False, max_length=_MOST)
    """Zones that planned paths avoid."""
    lighting: Lighting = Lighting()
    starts: Starts = ()
    """Start poses of the robots that name none themselves, in the order of the robots' names."""
    markers: WorldMarkers = WorldMarkers()
    cameras: dict[Name, OverheadCamera] = Field(default={}, json_schema_extra=NAMES_ONLY)
    """Cameras above the floor, for the plugin `tracker`."""
    physics: Physics = Physics()

    @cached_property
    def solid_obstacles(self) -> tuple[BoxObstacle | CircleObstacle, ...]:
        """The obstacles, with partitions as blocks."""
        return tuple(part.as_box() if isinstance(part, Partition) else part for part in self.obstacles)

    def place(self, name: str) -> NamedPlace:
        """Return a place by its name.

        Raises PlaceNotFoundError if there is none of that name; the message has the nearest name and all names.
        """
        if name in self.places:
            return self.places[name]
        if not self.places:
            raise PlaceNotFoundError(f"no place {name!r}: the world {self.name!r} has no `places`")
        near = nearest(name, self.places)
        hint = f"; did you mean {near!r}?" if near else "."
        raise PlaceNotFoundError(f"unknown place {name!r}{hint} Places of {self.name!r}: {', '.join(self.places)}")

    @property
    def start_poses(self) -> tuple[StartPose, ...]:
        """The start poses, also of a formation."""
        return formation_poses(self.starts) if isinstance(self.starts, Formation) else self.starts
