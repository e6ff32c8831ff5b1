"""The settings of a tracker in the fleet file."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import PositiveFloat, field_validator, model_validator

from eal_actors.plugin import FamilyName, Field, FloorMarker, PluginSettingsModel

from ..camera.source import PictureSource
from .lens import Lens

SIMULATED = "sim://"

Coefficients = Annotated[tuple[float, float, float, float, float], Field(strict=False)]


class LensSettings(PluginSettingsModel):
    """A lens, as `eal calibrate camera` prints it."""

    size_px: tuple[int, int] = Field(strict=False)
    """Width and height of the calibrated pictures."""
    focal_px: tuple[PositiveFloat, PositiveFloat] = Field(strict=False)
    """Focal lengths along the columns and the rows."""
    centre_px: tuple[float, float] = Field(strict=False)
    """Column and row of the axis; the centre of the first pixel is 0, 0."""
    distortion: Coefficients = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3 of OpenCV and ROS (`plumb_bob`)."""

    def lens(self) -> Lens:
        """Return the lens."""
        return Lens(self.size_px, self.focal_px, self.centre_px, self.distortion)


class CameraSettings(PluginSettingsModel):
    """One camera above the floor."""

    source: int | str
    """As in the plugin `camera`, or `sim://world/<camera>`."""
    lens: LensSettings
    latency_s: float = Field(default=0.0, ge=0, le=1)
    """Seconds from the middle of an exposure to the arrival of its picture."""
    fps: float | None = Field(default=None, ge=1, le=1000)
    """Requested rate of a camera, or rate of a folder of images or of a simulated camera."""
    fourcc: str | None = Field(default=None, pattern=r"^[ -~]{4}$")
    """Encoding of the pictures on the cable, such as MJPG."""
    loop: bool = False
    """Restart a video file or folder at its end."""
    timeout_s: float = Field(default=2.0, ge=0.1, le=60)
    """Seconds without a picture after which the camera counts as lost."""

    @field_validator("source")
    @classmethod
    def _check_source(cls, source: int | str) -> int | str:
        if source == "" or (isinstance(source, int) and source < 0):
            raise ValueError("use a number from 0, a device path, a URL, the path of a file or folder, or sim://...")
        if not str(source).startswith(SIMULATED):
            PictureSource.of(source)
        return source


class MarkerGroup(PluginSettingsModel):
    """Markers on robots that have the same size and place on their robots."""

    ids: tuple[int, ...] = Field(strict=False, min_length=1)
    size_m: float = Field(gt=0, le=5)
    """Side of the black square."""
    height_m: float = Field(ge=0, le=20)
    """Height of the print over the floor."""
    ahead_m: float = Field(default=0.0, ge=-5, le=5)
    """Place of its centre ahead of the robot's axis of rotation."""
    left_m: float = Field(default=0.0, ge=-5, le=5)
    """Place of its centre to the left of the axis."""
    yaw_deg: float = Field(default=0.0, ge=-360, le=360)
    """Turn of the print on the robot; 0 if its right edge points ahead."""


class Settings(PluginSettingsModel):
    """The plugin's settings in the fleet file."""

    cameras: dict[str, CameraSettings] = Field(min_length=1)
    """The cameras, by name."""
    markers: tuple[MarkerGroup, ...] = Field(strict=False, min_length=1)
    """The markers on robots."""
    floor: tuple[FloorMarker, ...] | None = Field(default=None, strict=False)
    """Markers on the floor, by which the cameras find their poses; by default `markers.floor` of the world file."""
    drawn: bool = True
    """Draw the pictures of simulated cameras, and search them; if not, compute where the markers are in view."""
    family: FamilyName | None = None
    """Family of all markers; by default that of the world file, or 4x4_50."""

    @model_validator(mode="after")
    def _check_ids(self) -> Self:
        ids = [number for group in self.markers for number in group.ids]
        ids += [marker.id for marker in self.floor or ()]
        if twice := sorted({number for number in ids if ids.count(number) > 1}):
            raise ValueError(f"markers {', '.join(map(str, twice))} are listed twice: each id marks one place")
        if min(ids) < 0:
            raise ValueError(f"markers: an id is 0 or more, not {min(ids)}")
        return self
