"""A simulated arena: a walled rectangle with obstacles, as a world file describes it.

The frame of a world: the origin is the middle of the floor, x points right, y points up, yaw turns counter-clockwise
from the x axis. Lengths are metres; angles are degrees, as the `_deg` in their names says.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, PositiveFloat, ValidationError

from eal_actors.errors import ConfigError
from eal_actors.strict_model import Name, StrictModel, Version1, problems_from
from eal_actors.yaml_source import load_yaml


class BoxObstacle(StrictModel):
    """A rectangular block, turned by `yaw_deg` about its middle."""

    kind: Literal["box"]
    x_m: float
    """Middle of the box."""
    y_m: float
    """Middle of the box."""
    width_m: PositiveFloat
    """Extent along the box's own x axis."""
    height_m: PositiveFloat
    """Extent along the box's own y axis."""
    yaw_deg: float = 0.0
    """Turn of the box's own x axis, counter-clockwise."""


class CircleObstacle(StrictModel):
    """A round pillar."""

    kind: Literal["circle"]
    x_m: float
    """Middle of the circle."""
    y_m: float
    """Middle of the circle."""
    radius_m: PositiveFloat


Obstacle = Annotated[BoxObstacle | CircleObstacle, Field(discriminator="kind")]


class Physics(StrictModel):
    """How the arena is simulated."""

    rate_hz: float = Field(default=50.0, gt=0, le=1000)
    """Steps in a second of the fleet's clock."""


class WorldModel(StrictModel):
    """A world file."""

    version: Version1
    name: Name
    size_m: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Width along x and height along y, between the walls."""
    obstacles: tuple[Obstacle, ...] = Field(default=(), strict=False)
    physics: Physics = Physics()


def load_world(path: str | Path) -> WorldModel:
    """Read a world file. The environment has no say in it: a world is the same on every machine.

    Raises:
        ConfigError: with every problem of the file.
    """
    tree = load_yaml(path)
    try:
        return WorldModel.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, WorldModel)) from None
