"""The parts of a world: surfaces, obstacles, boxes, beacons, drops, lamps, and start poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, NonNegativeFloat, PositiveFloat, model_validator

from eal_actors.kernel.strict_model import Name, StrictModel

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

Degrees = Annotated[float, Field(ge=-360, le=360)]


class SurfaceTexture(StrictModel):
    """The appearance of a surface: a pattern drawn from its colours and the world's seed."""

    pattern: Literal["plain", "checker", "stripes", "planks", "bricks", "plaster", "mosaic", "poster"]
    """`plaster` is rough, `mosaic` and `poster` are rich in features: each place on them looks different."""
    colours: Palette = ((200, 200, 200),)
    """The first is the background."""
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


class FloorItem(StrictModel):
    """A thing with a place on the floor."""

    x_m: float
    """Its centre."""
    y_m: float
    """Its centre."""


class Obstacle(FloorItem):
    """An obstacle that cannot be moved."""

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
        """Return it as a block."""
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


class MovableBox(FloorItem):
    """A box that robots can push over the floor."""

    name: Name
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(default=(0.3, 0.3), strict=False)
    """Extent along its own x axis and its own y axis."""
    height_m: PositiveFloat = 0.3
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
    radius_m: PositiveFloat = 0.05
    height_m: PositiveFloat = 1.0
    colour: Colour = (230, 40, 40)
    reach_m: PositiveFloat = 6.0
    """How far its signal carries; obstacles block it, robots do not."""


class Drop(FloorItem):
    """A hole in the floor, such as a stairwell: cliff sensors see it, and a wheel over it drops."""

    size_m: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Extent along its own x axis and its own y axis."""
    yaw_deg: Degrees = 0.0


class StartPose(FloorItem):
    """The pose of a robot at the start."""

    yaw_deg: Degrees = 0.0
    """Its heading."""

    @model_validator(mode="before")
    @classmethod
    def _refuse_formation(cls, value: Any) -> Any:
        if isinstance(value, Mapping) and "shape" in value:
            raise ValueError("is a formation, which stands alone: `starts: {shape: ...}`, without a list around it")
        return value


class Physics(StrictModel):
    """The settings of the physics simulation."""

    rate_hz: float = Field(default=50.0, gt=0, le=1000)
    """Steps in a second of the fleet's clock."""
