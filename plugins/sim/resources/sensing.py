"""What a simulated robot senses of the world round it."""

from __future__ import annotations

import json
import math

import numpy as np

from eal_actors.plugin import DataType, EALData, ResourceType, ValueInfo, config, config_setter, request

from ..robot import SimRobot
from ..sensors import (
    MAX_RANGE_M,
    RAY_ANGLES_RAD,
    RAYS,
    Cliffs,
    DroppedWheels,
    compass_rad,
    dropped_wheels,
    is_wall_near,
    light_lux,
    pressed_bumpers,
    ranges_m,
    seen_beacons,
    seen_cliffs,
)
from ..world import SimWorld
from .on_robot import OnRobot

_BOOL = ValueInfo(DataType.BOOL)


class Bump(OnRobot):
    """Whether something touches the front half of the robot."""

    types = ResourceType.SENSOR
    value = _BOOL

    def get_value(self) -> EALData:
        """Return whether any bumper is pressed now."""
        (left, right), now_s = self._pressed()
        return EALData.of(left or right, stamp_s=now_s)

    @request("left", _BOOL)
    def left(self) -> EALData:
        """Tell whether the left bumper is pressed; something straight ahead presses both."""
        (left, _), now_s = self._pressed()
        return EALData.of(left, stamp_s=now_s)

    @request("right", _BOOL)
    def right(self) -> EALData:
        """Tell whether the right bumper is pressed; something straight ahead presses both."""
        (_, right), now_s = self._pressed()
        return EALData.of(right, stamp_s=now_s)

    def _pressed(self) -> tuple[tuple[bool, bool], float]:
        with self._world.caught_up() as now_s:
            return pressed_bumpers(self._robot), now_s


class Cliff(OnRobot):
    """Whether the floor falls away under the robot's front edge."""

    types = ResourceType.SENSOR
    value = _BOOL

    def get_value(self) -> EALData:
        """Return whether any of the four sensors sees a drop now."""
        cliffs, now_s = self._cliffs()
        return EALData.of(any(cliffs), stamp_s=now_s)

    @request("left", _BOOL)
    def left(self) -> EALData:
        """Tell whether the sensor 60 degrees to the left sees a drop."""
        cliffs, now_s = self._cliffs()
        return EALData.of(cliffs.left, stamp_s=now_s)

    @request("front_left", _BOOL)
    def front_left(self) -> EALData:
        """Tell whether the sensor 20 degrees to the left sees a drop."""
        cliffs, now_s = self._cliffs()
        return EALData.of(cliffs.front_left, stamp_s=now_s)

    @request("front_right", _BOOL)
    def front_right(self) -> EALData:
        """Tell whether the sensor 20 degrees to the right sees a drop."""
        cliffs, now_s = self._cliffs()
        return EALData.of(cliffs.front_right, stamp_s=now_s)

    @request("right", _BOOL)
    def right(self) -> EALData:
        """Tell whether the sensor 60 degrees to the right sees a drop."""
        cliffs, now_s = self._cliffs()
        return EALData.of(cliffs.right, stamp_s=now_s)

    def _cliffs(self) -> tuple[Cliffs, float]:
        with self._world.caught_up() as now_s:
            return seen_cliffs(self._world, self._robot), now_s


class WheelDrop(OnRobot):
    """Whether a wheel hangs over a drop."""

    types = ResourceType.SENSOR
    value = _BOOL

    def get_value(self) -> EALData:
        """Return whether any wheel has dropped."""
        dropped, now_s = self._dropped()
        return EALData.of(any(dropped), stamp_s=now_s)

    @request("left", _BOOL)
    def left(self) -> EALData:
        """Tell whether the left wheel has dropped."""
        dropped, now_s = self._dropped()
        return EALData.of(dropped.left, stamp_s=now_s)

    @request("right", _BOOL)
    def right(self) -> EALData:
        """Tell whether the right wheel has dropped."""
        dropped, now_s = self._dropped()
        return EALData.of(dropped.right, stamp_s=now_s)

    @request("caster", _BOOL)
    def caster(self) -> EALData:
        """Tell whether the caster, the small wheel in front, has dropped."""
        dropped, now_s = self._dropped()
        return EALData.of(dropped.caster, stamp_s=now_s)

    def _dropped(self) -> tuple[DroppedWheels, float]:
        with self._world.caught_up() as now_s:
            return dropped_wheels(self._world, self._robot), now_s


class Wall(OnRobot):
    """Whether something is within 5 cm of the hull at the right-hand side, a little ahead."""

    types = ResourceType.SENSOR
    value = _BOOL

    def get_value(self) -> EALData:
        """Return whether something is near at the right-hand side."""
        with self._world.caught_up() as now_s:
            is_near = is_wall_near(self._robot)
        return EALData.of(is_near, stamp_s=now_s)

    @request("virtual", _BOOL)
    def virtual(self) -> EALData:
        """Tell whether a virtual wall's beam is seen; a simulated world has none."""
        with self._world.caught_up() as now_s:
            return EALData.of(False, stamp_s=now_s)


class Range(OnRobot):
    """Distances from the robot's centre along 16 rays, the first ahead, then to the left; at most 4 m."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "m", shape=(RAYS,))

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._noise_m = 0.0
        self._max_range_m = MAX_RANGE_M
        self._frame_id = f"{robot.name}/base"

    def get_value(self) -> EALData:
        """Return the distances, the greatest range where a ray meets nothing; noise does not make them longer."""
        with self._world.caught_up() as now_s:
            found_m = ranges_m(self._world, self._robot, now_s)
            if self._noise_m:
                noise_m = self._noise_m * self._robot.sensor_generator.standard_normal(RAYS)
                is_echo = found_m < self._max_range_m
                found_m = np.where(is_echo, np.maximum(found_m + noise_m, 0.0), found_m)
        return EALData.of(np.minimum(found_m, self._max_range_m), unit="m", frame_id=self._frame_id, stamp_s=now_s)

    @request("angles", ValueInfo(DataType.DOUBLE, "rad", shape=(RAYS,)))
    def angles(self) -> EALData:
        """Return the rays' angles from straight ahead, counter-clockwise."""
        return EALData.of(RAY_ANGLES_RAD, unit="rad", frame_id=self._frame_id)

    @config("noise_m", ValueInfo(DataType.DOUBLE, "m", 0, 1))
    def noise_m(self) -> float:
        """Standard deviation of the distances' noise."""
        return self._noise_m

    @config_setter("noise_m")
    def set_noise_m(self, noise_m: float) -> None:
        """Set the noise of later values."""
        self._noise_m = float(noise_m)

    @config("max_range_m", ValueInfo(DataType.DOUBLE, "m", 0.1, MAX_RANGE_M))
    def max_range_m(self) -> float:
        """Greatest range; what is farther away is not seen."""
        return self._max_range_m

    @config_setter("max_range_m")
    def set_max_range_m(self, max_range_m: float) -> None:
        """Set the greatest range of later values."""
        self._max_range_m = float(max_range_m)


class Compass(OnRobot):
    """The robot's yaw in rad, in (-pi, pi], counter-clockwise from the world's x axis."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "rad", -math.pi, math.pi)

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._noise_rad = 0.0

    def get_value(self) -> EALData:
        """Return the yaw."""
        with self._world.caught_up() as now_s:
            yaw_rad = compass_rad(self._robot, self._noise_rad)
        return EALData.of(yaw_rad, unit="rad", frame_id="world", stamp_s=now_s)

    @config("noise_rad", ValueInfo(DataType.DOUBLE, "rad", 0, 1))
    def noise_rad(self) -> float:
        """Standard deviation of the yaw's noise."""
        return self._noise_rad

    @config_setter("noise_rad")
    def set_noise_rad(self, noise_rad: float) -> None:
        """Set the noise of later values."""
        self._noise_rad = float(noise_rad)


class Light(OnRobot):
    """The light that falls on the top of the robot, in lux."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "lx", 0)

    def get_value(self) -> EALData:
        """Return the light of the room and of the lamps in sight."""
        with self._world.caught_up() as now_s:
            lux = light_lux(self._world, self._robot, now_s)
        return EALData.of(lux, unit="lx", stamp_s=now_s)


class Beacons(OnRobot):
    """Bearing in rad and distance in m of each beacon, in the order of the world file; NaN where it is not seen."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(None, 2), description="bearing_rad, distance_m")

    def get_value(self) -> EALData:
        """Return one row for each beacon; bearings are counter-clockwise from straight ahead, in (-pi, pi]."""
        with self._world.caught_up() as now_s:
            seen = seen_beacons(self._world, self._robot, now_s)
        return EALData.of(seen, frame_id=f"{self._robot.name}/base", stamp_s=now_s)

    @request("names", ValueInfo(DataType.CHAR, description="JSON list of strings"))
    def names(self) -> EALData:
        """Return the beacons' names in the order of the rows, as a JSON list."""
        return EALData.of(json.dumps([beacon.name for beacon in self._world.model.beacons]))
