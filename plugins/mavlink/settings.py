"""The settings of the mavlink plugin in the fleet file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import field_validator

from eal_actors.plugin import Field, MobileBaseSettings

from .fence import Fence

Corner = Annotated[tuple[float, float], Field(strict=False)]


class Settings(MobileBaseSettings):
    """The plugin's settings in the fleet file."""

    port: str = Field(default="udp://0.0.0.0:14550", pattern=r"^(udp|tcp)://[^/\s:]+:\d{1,5}$|^/\S+$")
    """`udp://HOST:PORT` listens there, `tcp://HOST:PORT` connects, `/dev/...` is a serial port."""
    baud: int = Field(default=57600, ge=1200, le=4_000_000)
    """Speed of a serial port."""
    vehicle: Literal["rover", "copter"] = "rover"
    """Its kind."""
    system_id: int = Field(default=1, ge=1, le=255)
    """The vehicle's MAVLink system."""
    own_system_id: int = Field(default=245, ge=1, le=255)
    """The MAVLink system of this program, a ground station."""
    auto_arm: bool = False
    """Whether a motion arms the vehicle and switches it to the guided mode; else it is refused until a person did."""
    geofence: tuple[Corner, ...] | None = Field(default=None, strict=False)
    """Corners x_m, y_m of the polygon that motions must not leave, in the map."""
    max_altitude_m: float = Field(default=10.0, gt=0, le=500)
    """Greatest altitude of a copter above its start."""
    timeout_s: float = Field(default=3.0, gt=0, le=60)
    """Silence of the vehicle after which it is not ready, and a motion ends; in seconds of the fleet's clock."""
    odometry_timeout_s: float = Field(default=1.0, gt=0, le=60)
    """Age of its newest position after which it is not ready, and a motion ends; in seconds of the fleet's clock."""

    @field_validator("geofence")
    @classmethod
    def _check_geofence(cls, corners: tuple[tuple[float, float], ...] | None) -> tuple[tuple[float, float], ...] | None:
        if corners is not None:
            Fence(corners)
        return corners
