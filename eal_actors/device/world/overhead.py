"""Cameras above the floor of a world, and the markers that they find."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, NonNegativeFloat, PositiveFloat

from eal_actors.device.markers import FamilyName
from eal_actors.kernel.strict_model import StrictModel

Heading = Annotated[float, Field(ge=-360, le=360)]
MarkerId = Annotated[int, Field(ge=0)]


class FloorMarker(StrictModel):
    """A marker that lies on the floor, face up."""

    id: MarkerId
    x_m: float
    """Its centre."""
    y_m: float
    """Its centre."""
    yaw_deg: Heading = 0.0
    """Direction from the left edge of the print to its right edge, counter-clockwise from the x axis."""
    size_m: PositiveFloat
    """Side of its black square."""


class WorldMarkers(StrictModel):
    """The printed markers in a world, all of one family."""

    family: FamilyName = "4x4_50"
    size_m: PositiveFloat = 0.12
    """Side of the black square of the markers on simulated robots."""
    floor: tuple[FloorMarker, ...] = Field(default=(), strict=False)
    """Markers on the floor, by which cameras find their own poses."""


class OverheadCamera(StrictModel):
    """A camera above the floor that looks down."""

    x_m: float = 0.0
    y_m: float = 0.0
    z_m: PositiveFloat
    """Height over the floor."""
    yaw_deg: Heading = 90.0
    """Direction on the floor that is up in the picture, counter-clockwise from the x axis."""
    tilt_deg: float = Field(default=0.0, ge=0, le=45)
    """Angle of its axis from straight down, towards the top of the picture."""
    width: int = Field(default=1280, ge=16, le=4096)
    height: int = Field(default=960, ge=16, le=4096)
    fov_deg: float = Field(default=70.0, ge=10, le=120)
    """Angle between the left and the right edge of the picture, before distortion."""
    distortion: tuple[float, float, float, float, float] = Field(default=(0.0,) * 5, strict=False)
    """Of the lens: k1, k2, p1, p2, k3, as OpenCV and ROS have them."""
    noise: float = Field(default=3.0, ge=0, le=100)
    """Standard deviation of the noise of every colour value, in grey levels."""
    blur_px: NonNegativeFloat = Field(default=0.6, le=10)
    """Standard deviation of the blur."""
    exposure_s: float = Field(default=0.0, ge=0, le=0.2)
    """Length of an exposure: a robot that moves is blurred along its way."""
