"""The settings of the ros2 plugin in the fleet file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator

from eal_actors.plugin import Field, MobileBaseSettings, PluginSettingsModel, Radius, Speed

from .graph import check_name

RosName = Annotated[str, AfterValidator(check_name)]
TypeName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*(/(msg|srv|action))?/[A-Z][A-Za-z0-9_]*$")]
ResourceName = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


class TopicSettings(PluginSettingsModel):
    """A topic as a resource."""

    topic: RosName
    """Its name; without a leading slash, it is in the namespace."""
    type: TypeName
    """Its message type, such as sensor_msgs/msg/LaserScan."""
    writable: bool = False
    """Whether set_value publishes it; then the resource does not subscribe."""
    latched: bool = False
    """Whether its publisher keeps the last message for late subscribers (transient local), as of /map or /tf_static."""
    timeout_s: float | None = Field(default=None, gt=0, le=3600)
    """Silence after which the resource is not ready, in seconds of the fleet's clock; None for none."""
    max_bytes: int = Field(default=16_000_000, ge=64, le=1 << 28)
    """Longest message that is read."""


class ServiceSettings(PluginSettingsModel):
    """A service as a resource: send_req with the request as JSON."""

    service: RosName
    """Its name."""
    type: TypeName
    """Its type, such as std_srvs/srv/SetBool."""
    timeout_s: float = Field(default=5.0, gt=0, le=600)
    """Longest wait for the answer, in real seconds."""


class DriveSettings(MobileBaseSettings):
    """The base: it is driven by velocities, and measured by odometry."""

    cmd_vel: RosName = "cmd_vel"
    """Topic of the velocities."""
    stamped: bool = False
    """Whether they are geometry_msgs/msg/TwistStamped, as ros2_control of Jazzy and later expects."""
    odometry: RosName = "odom"
    """Topic of the odometry, nav_msgs/msg/Odometry."""
    navigate: RosName | None = None
    """Action of Nav2 that drives to a place, such as navigate_to_pose; None for our own closed loop."""
    track_m: float = Field(default=0.3, gt=0, le=10)
    """Distance of its wheels."""
    radius_m: Radius = 0.2
    """Radius of the robot about its centre."""
    speed_m_s: Speed = 0.2
    """Usual speed."""
    max_speed_m_s: Speed = 0.5
    """Greatest speed."""
    acceleration_m_s2: float = Field(default=0.4, gt=0, le=100)
    """Acceleration of each wheel."""
    odometry_timeout_s: float = Field(default=1.0, gt=0, le=60)
    """Age of the odometry at which a motion stops and the base is not ready, in seconds of the fleet's clock."""


class GraphSettings(PluginSettingsModel):
    """A session in a ROS 2 graph."""

    router: str = Field(default="tcp/127.0.0.1:7447", pattern=r"^(tcp|tls|quic|udp|unixsock-stream)/\S+$")
    """Endpoint of the zenoh router (`rmw_zenohd`), or of a robot that listens."""
    zenoh_config: str | None = None
    """A zenoh configuration file, for certificates."""
    domain: int = Field(default=0, ge=0, le=232)
    """The ROS domain (ROS_DOMAIN_ID)."""
    distribution: Literal["humble", "jazzy", "kilted"] = "jazzy"
    """The ROS 2 distribution of the other nodes: their message definitions. Humble has no type hashes."""


class Settings(GraphSettings):
    """The plugin's settings in the fleet file."""

    namespace: str = Field(default="/", pattern=r"^/?([A-Za-z_][A-Za-z0-9_]*/?)*$")
    """Namespace of the robot's topics and services."""
    messages: str | None = None
    """Folder of further definitions: <package>/msg/<Name>.msg, srv and action likewise."""
    drive: DriveSettings | None = None
    """The base; without it the robot is not driven."""
    topics: dict[ResourceName, TopicSettings] = Field(default={})
    """Topics as resources, by the resources' names."""
    services: dict[ResourceName, ServiceSettings] = Field(default={})
    """Services as resources, by the resources' names."""
