"""The settings of the vda5050 plugin in the fleet file, and of `eal bridge vda5050`."""

from __future__ import annotations

from typing import Annotated

from eal_actors.plugin import Field, MobileBaseSettings, Radius

from ..mqtt.settings import BrokerSettings

TopicLevel = Annotated[str, Field(pattern=r"^[^/+#$\s\x00]{1,100}$")]


class Settings(BrokerSettings, MobileBaseSettings):
    """The plugin's settings in the fleet file."""

    manufacturer: TopicLevel
    """The AGV's manufacturer, as in its topics."""
    serial_number: TopicLevel
    """The AGV's serial number, as in its topics."""
    interface: TopicLevel = "uagv"
    """The first level of the topics."""
    map_id: str | None = None
    """The map of the goals; None for the map that the AGV is on."""
    radius_m: Radius = 0.5
    """Radius of the AGV about its centre. The usual speeds are maxSpeed and maxRotationSpeed of the edges."""
    goal_deviation_m: float = Field(default=0.1, gt=0, le=10)
    """Distance from a goal at which the AGV may say that it has arrived: allowedDeviationXY."""
    accept_timeout_s: float = Field(default=5.0, gt=0, le=300)
    """Longest wait until the AGV's state shows a new order, in seconds of the fleet's clock."""
    state_timeout_s: float = Field(default=40.0, gt=0, le=3600)
    """Silence after which the AGV is not ready; the standard demands a state at least every 30 s."""


class BridgeSettings(BrokerSettings):
    """The settings of `eal bridge vda5050`."""

    manufacturer: TopicLevel = "EAL"
    """The manufacturer of all robots; the serial number is the robot's name."""
    interface: TopicLevel = "uagv"
    """The first level of the topics."""
    map_id: str = Field(default="map", min_length=1, max_length=100)
    """The name of the fleet's map."""
    state_period_s: float = Field(default=1.0, gt=0, le=30)
    """Longest time between two states; each event sends one too."""
    visualization_rate_hz: float = Field(default=5.0, gt=0, le=50)
    """Poses in a second."""
