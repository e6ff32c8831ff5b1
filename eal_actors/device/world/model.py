"""The model of a world file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Discriminator, Field, PositiveFloat, Tag

from eal_actors.device.world.formation import Formation, formation_poses
from eal_actors.device.world.parts import (
    AnyObstacle,
    Beacon,
    BoxObstacle,
    CircleObstacle,
    Drop,
    Lighting,
    MovableBox,
    Partition,
    Physics,
    Poster,
    StartPose,
    Surfaces,
    SurfaceTexture,
)
from eal_actors.kernel.strict_model import NAMES_ONLY, Name, StrictModel, Version1


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
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Extent along x and along y, between the walls."""
    height_m: PositiveFloat = 2.5
    """From the floor to the ceiling."""
    seed: int = Field(default=0, ge=0)
    """Seed of the world's own random choices, such as the patterns of textures. Robots use the fleet's seed."""
    textures: dict[Name, SurfaceTexture] = Field(default={}, json_schema_extra=NAMES_ONLY)
    surfaces: Surfaces = Surfaces()
    posters: tuple[Poster, ...] = Field(default=(), strict=False)
    obstacles: tuple[AnyObstacle, ...] = Field(default=(), strict=False)
    boxes: tuple[MovableBox, ...] = Field(default=(), strict=False)
    beacons: tuple[Beacon, ...] = Field(default=(), strict=False)
    drops: tuple[Drop, ...] = Field(default=(), strict=False)
    lighting: Lighting = Lighting()
    starts: Starts = ()
    """Start poses of the robots that name none themselves, in the order of the robots' names."""
    physics: Physics = Physics()

    @property
    def solid_obstacles(self) -> tuple[BoxObstacle | CircleObstacle, ...]:
        """The obstacles, with partitions as blocks."""
        return tuple(part.as_box() if isinstance(part, Partition) else part for part in self.obstacles)

    @property
    def start_poses(self) -> tuple[StartPose, ...]:
        """The start poses, also of a formation."""
        return formation_poses(self.starts) if isinstance(self.starts, Formation) else self.starts
