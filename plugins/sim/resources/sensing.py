"""The sensors of a simulated robot: its battery and what it senses of the world."""

from __future__ import annotations

import json
import math

from typing_extensions import override

from eal_actors.plugin import DataType, EALData, ResourceType, ValueInfo, request, setting

from ...roomba.senses import (
    BatteryReading,
    BumpSensor,
    CasterDropSensor,
    CliffSensor,
    PowerSensor,
    WallSensor,
)
from ..robot import SimRobot
from ..sensors import (
    MAX_RANGE_M,
    RAY_ANGLES_RAD,
    RAYS,
    Array,
    RayCaster,
    compass_rad,
    dropped_wheels,
    is_wall_near,
    light_lux,
    pressed_bumpers,
    seen_beacons,
    seen_cliffs,
    shared,
)
from ..world import SimWorld
from .ranging import RangingResource
from .robot_resource import RobotResource


class Battery(RobotResource, PowerSensor):
    """The battery's charge, 0 to 1."""

    @override
    def read_battery(self) -> tuple[BatteryReading, float]:
        return self._sense(self._battery)

    def _battery(self, _: float) -> BatteryReading:
        found = self._robot.battery
        return BatteryReading(*(getattr(found, field) for field in BatteryReading._fields))


class Bump(RobotResource, BumpSensor):
    """Whether something touches the front half of the robot."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self._sense(lambda _: pressed_bumpers(self._robot))


class Cliff(RobotResource, CliffSensor):
    """Whether the floor falls away under the robot's front edge."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self._sense(lambda _: seen_cliffs(self._world, self._robot))


class WheelDrop(RobotResource, CasterDropSensor):
    """Whether a wheel hangs over a drop."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self._sense(lambda _: dropped_wheels(self._world, self._robot))


class Wall(RobotResource, WallSensor):
    """Whether something is within 5 cm of the hull at the right-hand side, a little ahead."""

    @override
    def read_flags(self) -> tuple[tuple[bool, ...], float]:
        return self._sense(lambda _: (is_wall_near(self._robot), False))


class Range(RangingResource):
    """Distances from the robot's centre along 16 rays, the first ahead, then to the left; at most 4 m."""

    value = ValueInfo(DataType.DOUBLE, "m", shape=(RAYS,))
    max_range_m: float = setting(
        ValueInfo(DataType.DOUBLE, "m", 0.1, MAX_RANGE_M), "Greatest range; anything farther away is not seen."
    )

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot, 0.0, MAX_RANGE_M, robot.sensor_generator)
        with world.lock:
            world.catch_up()
            self._rays = shared(world, RayCaster)

    def get_value(self) -> EALData:
        """Return the distances, the greatest range where a ray hits nothing; noise does not exceed that range."""
        return self._read(self._distances_m, "m", "base")

    def _distances_m(self, now_s: float) -> Array:
        found_m = self._rays.ranges_m(self._world, self._robot, now_s)
        return self._measured(found_m) if self.noise_m or self.max_range_m < MAX_RANGE_M else found_m.copy()

    @request("angles", ValueInfo(DataType.DOUBLE, "rad", shape=(RAYS,)))
    def angles(self) -> EALData:
        """Return the rays' angles from straight ahead, counter-clockwise."""
        return EALData.of(RAY_ANGLES_RAD, unit="rad", frame_id=f"{self._robot.name}/base")


class Compass(RobotResource):
    """The robot's yaw in rad, in (-pi, pi], counter-clockwise from the world's x axis."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "rad", -math.pi, math.pi)

    noise_rad: float = setting(ValueInfo(DataType.DOUBLE, "rad", 0, 1), "Standard deviation of the yaw's noise.")

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self.noise_rad = 0.0

    def get_value(self) -> EALData:
        """Return the yaw."""
        with self._world.lock:
            now_s = self._world.catch_up()
            yaw_rad = compass_rad(self._robot, self.noise_rad)
        return EALData.of(yaw_rad, unit="rad", frame_id="world", stamp_s=now_s)


class Light(RobotResource):
    """The light that falls on the top of the robot, in lux."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "lx", 0)

    def get_value(self) -> EALData:
        """Return the light of the room and of the lamps in sight."""
        return self._read(lambda _: light_lux(self._world, self._robot), "lx")


class Beacons(RobotResource):
    """Bearing in rad and distance in m of each beacon, in the order of the world file; NaN where it is not seen."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(None, 2), description="bearing_rad, distance_m")

    def get_value(self) -> EALData:
        """Return one row for each beacon; bearings are counter-clockwise from straight ahead, in (-pi, pi]."""
        return self._read(lambda _: seen_beacons(self._world, self._robot), frame="base")

    @request("names", ValueInfo(DataType.CHAR, description="JSON list of strings"))
    def names(self) -> EALData:
        """Return the beacons' names in the order of the rows, as a JSON list."""
        return EALData.of(json.dumps([beacon.name for beacon in self._world.model.beacons]))
