"""The resources of a simulated robot."""

from __future__ import annotations

import math

import numpy as np

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DataType,
    EALData,
    Resource,
    ResourceType,
    ValueInfo,
    command,
    config,
    config_setter,
    request,
)

from .models import MAKES
from .motion import Motion
from .robot import SimRobot
from .sensors import (
    CAMERA_HEIGHT_PX,
    CAMERA_WIDTH_PX,
    RAY_ANGLES_RAD,
    RAYS,
    draw_test_card,
    pressed_bumpers,
    ranges_m,
    wrapped_rad,
)
from .world import SimWorld

_DISTANCE = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_SPEED = ValueInfo(DataType.DOUBLE, "m/s", 0.01, max(make.max_speed_m_s for make in MAKES.values()))
_TURN_RATE = ValueInfo(DataType.DOUBLE, "deg/s", 1, max(make.max_turn_rate_deg_s for make in MAKES.values()))


class _OnRobot(Resource):
    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        self._world = world
        self._robot = robot


class Base(_OnRobot):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked."""

    types = ResourceType.ACTUATOR

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._speed_m_s = robot.make.speed_m_s
        self._turn_rate_deg_s = robot.make.turn_rate_deg_s
        self._step_m = 0.5

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves, 2 while something holds it up."""
        with self._world.caught_up():
            if self._robot.motion is None:
                return 0
            return 2 if self._robot.is_blocked else 1

    def halt(self) -> None:
        """Stop at once."""
        with self._world.caught_up():
            self._world.stop(self._robot)

    @command("g")
    def go(self) -> Activity:
        """Drive one step forward."""
        return self._drive(self._step_m)

    @command("b")
    def back(self) -> Activity:
        """Drive one step back."""
        return self._drive(-self._step_m)

    @command("l")
    def left(self) -> Activity:
        """Turn left by 90 degrees."""
        return self._turn(90.0)

    @command("r")
    def right(self) -> Activity:
        """Turn right by 90 degrees."""
        return self._turn(-90.0)

    @command("s", urgent=True)
    def stop(self) -> int:
        """Stop at once."""
        self.halt()
        return 1

    @command("f<metres>", _DISTANCE)
    def go_by(self, metres: float) -> Activity:
        """Drive forward by a distance."""
        return self._drive(metres)

    @command("b<metres>", _DISTANCE)
    def back_by(self, metres: float) -> Activity:
        """Drive back by a distance."""
        return self._drive(-metres)

    @command("l<degrees>", _ANGLE)
    def left_by(self, degrees: float) -> Activity:
        """Turn left by an angle."""
        return self._turn(degrees)

    @command("r<degrees>", _ANGLE)
    def right_by(self, degrees: float) -> Activity:
        """Turn right by an angle."""
        return self._turn(-degrees)

    @config("speed_m_s", _SPEED)
    def speed_m_s(self) -> float:
        """Speed of driving straight."""
        return self._speed_m_s

    @config_setter("speed_m_s")
    def set_speed_m_s(self, speed_m_s: float) -> None:
        """Set the speed of later commands."""
        self._check_reach("speed_m_s", speed_m_s, self._robot.make.max_speed_m_s)
        self._speed_m_s = float(speed_m_s)

    @config("turn_rate_deg_s", _TURN_RATE)
    def turn_rate_deg_s(self) -> float:
        """Speed of turning in place."""
        return self._turn_rate_deg_s

    @config_setter("turn_rate_deg_s")
    def set_turn_rate_deg_s(self, turn_rate_deg_s: float) -> None:
        """Set the turn rate of later commands."""
        self._check_reach("turn_rate_deg_s", turn_rate_deg_s, self._robot.make.max_turn_rate_deg_s)
        self._turn_rate_deg_s = float(turn_rate_deg_s)

    @config("step_m", ValueInfo(DataType.DOUBLE, "m", 0.01, 10))
    def step_m(self) -> float:
        """Distance of the commands g and b."""
        return self._step_m

    @config_setter("step_m")
    def set_step_m(self, step_m: float) -> None:
        """Set the distance of later commands g and b."""
        self._step_m = float(step_m)

    def _check_reach(self, key: str, value: float, most: float) -> None:
        if value > most:
            raise ArgumentError(
                f"configuration key {key!r}: the {self._robot.make.name} reaches {most:g}, not {value:g}"
            )

    def _drive(self, distance_m: float) -> Activity:
        return self._run(Motion.straight(self._robot.make, distance_m, self._speed_m_s, self._world.tick_s))

    def _turn(self, degrees: float) -> Activity:
        rate_rad_s = math.radians(self._turn_rate_deg_s)
        return self._run(Motion.turn(self._robot.make, math.radians(degrees), rate_rad_s, self._world.tick_s))

    def _run(self, motion: Motion) -> Activity:
        with self._world.caught_up():
            self._world.start(self._robot, motion)
        try:
            while not motion.is_over:
                yield motion.remaining_s
                with self._world.caught_up():
                    pass
            return 1
        finally:
            with self._world.caught_up():
                if self._robot.motion is motion:
                    self._world.stop(self._robot)


class Pose(_OnRobot):
    """The robot's true x in m, y in m and yaw in rad, in (-pi, pi], counter-clockwise from the world's x axis."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, shape=(3,), description="x_m, y_m, yaw_rad")

    def get_value(self) -> EALData:
        """Return [x_m, y_m, yaw_rad]."""
        with self._world.caught_up() as now_s:
            x_m, y_m, yaw_rad = self._robot.pose
        pose = np.array([x_m, y_m, wrapped_rad(yaw_rad)])
        return EALData.of(pose, frame_id="world", stamp_s=now_s)


class Bump(_OnRobot):
    """Whether something touches the front half of the robot."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.BOOL)

    def get_value(self) -> EALData:
        """Return whether any bumper is pressed now."""
        (left, right), now_s = self._pressed()
        return EALData.of(left or right, stamp_s=now_s)

    @request("left", ValueInfo(DataType.BOOL))
    def left(self) -> EALData:
        """Tell whether the left bumper is pressed; something straight ahead presses both."""
        (left, _), now_s = self._pressed()
        return EALData.of(left, stamp_s=now_s)

    @request("right", ValueInfo(DataType.BOOL))
    def right(self) -> EALData:
        """Tell whether the right bumper is pressed; something straight ahead presses both."""
        (_, right), now_s = self._pressed()
        return EALData.of(right, stamp_s=now_s)

    def _pressed(self) -> tuple[tuple[bool, bool], float]:
        with self._world.caught_up() as now_s:
            return pressed_bumpers(self._robot), now_s


class Range(_OnRobot):
    """Distances from the robot's centre along 16 rays, the first ahead, then to the left; at most 4 m."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.DOUBLE, "m", shape=(RAYS,))

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._noise_m = 0.0

    def get_value(self) -> EALData:
        """Return the distances; 4 m where a ray meets nothing."""
        with self._world.caught_up() as now_s:
            distances_m = ranges_m(self._robot, self._noise_m)
        return EALData.of(distances_m, unit="m", frame_id=f"{self._robot.name}/base", stamp_s=now_s)

    @request("angles", ValueInfo(DataType.DOUBLE, "rad", shape=(RAYS,)))
    def angles(self) -> EALData:
        """Return the rays' angles from straight ahead, counter-clockwise."""
        return EALData.of(RAY_ANGLES_RAD, unit="rad", frame_id=f"{self._robot.name}/base")

    @config("noise_m", ValueInfo(DataType.DOUBLE, "m", 0, 1))
    def noise_m(self) -> float:
        """Standard deviation of the distances' noise."""
        return self._noise_m

    @config_setter("noise_m")
    def set_noise_m(self, noise_m: float) -> None:
        """Set the noise of later values."""
        self._noise_m = float(noise_m)


class Camera(_OnRobot):
    """Test card showing the heading; not a view of the world (the perspective camera is not built yet)."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.CHAR, shape=(CAMERA_HEIGHT_PX, CAMERA_WIDTH_PX, 3), description="RGB, rows from the top")

    def get_value(self) -> EALData:
        """Return the test card for the present heading."""
        with self._world.caught_up() as now_s:
            _, _, yaw_rad = self._robot.pose
        return EALData.of(draw_test_card(yaw_rad), frame_id=f"{self._robot.name}/camera", stamp_s=now_s)

    @config("width", ValueInfo(DataType.INT, "px"))
    def width(self) -> int:
        """Width of the image."""
        return CAMERA_WIDTH_PX

    @config("height", ValueInfo(DataType.INT, "px"))
    def height(self) -> int:
        """Height of the image."""
        return CAMERA_HEIGHT_PX
