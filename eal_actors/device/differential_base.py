"""The base of most robots on a floor: two driven wheels or tracks, and the commands of the thesis's experiments.

A driver implements three motions and inherits the rest: the commands with their units and ranges, the configuration
keys and the argument checks. So a controller finds the same `Base` on each robot.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from typing_extensions import override

from eal_actors.device.data import DataType, EALData, ValueInfo
from eal_actors.device.drivetrain import Drivetrain, WheelCalibration
from eal_actors.device.info import ResourceInfo, ResourceType
from eal_actors.device.motion.closed_loop import ClosedLoop, MotionDevice
from eal_actors.device.motion.route import Point, Route
from eal_actors.device.motion.route_controller import MotionLimits, RouteController
from eal_actors.device.resource import Activity, Resource, command, config, config_setter
from eal_actors.kernel.errors import ArgumentError, UnsupportedError

if TYPE_CHECKING:
    from eal_actors.device.plugin_context import PluginContext

_DISTANCE: Final = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_SPEED: Final = ValueInfo(DataType.DOUBLE, "m/s", 0.01)  # the greatest is the drivetrain's, see _make_info
_TURN_RATE: Final = ValueInfo(DataType.DOUBLE, "deg/s", 1)
_STEP: Final = ValueInfo(DataType.DOUBLE, "m", 0.01, 10)
_TWIST_TIMEOUT: Final = ValueInfo(DataType.DOUBLE, "s", 0.1, 60)
_RADIUS: Final = ValueInfo(DataType.DOUBLE, "m", 0, 10)
_TRACK: Final = ValueInfo(DataType.DOUBLE, "m", 0, 10)
_TRACK_FACTOR: Final = ValueInfo(DataType.DOUBLE, None, 0.5, 2, description="a factor; 1 is nominal")
_WHEEL_RATIO: Final = ValueInfo(DataType.DOUBLE, None, 0.9, 1.1, description="a ratio; 1 is nominal")
_GOAL: Final = ValueInfo(DataType.DOUBLE, "m", shape=(None,), description="x_m, y_m and perhaps yaw_rad, in the map")
_PATH: Final = ValueInfo(DataType.DOUBLE, "m", shape=(None, 2), description="waypoints x_m, y_m, in the map")
_UNCERTAINTY: Final = ValueInfo(DataType.DOUBLE, "m", 0.01, 100)
_ROUNDING: Final = 1e-9

BLOCKED: Final = 2
"""The status of a base that is driven, but held by something."""


class DifferentialBase(Resource, ABC):
    """Drives a robot with two driven wheels (Source: thesis §6.2.1, §6.2.2).

    A driver implements `drive`, `turn` and `follow`, the property `calibration`, `halt` and `get_status`; and
    `clearance_m`, if the robot has sensors for it.

    Args:
        drivetrain: the robot's drivetrain.
        context: the plugin's, whose localizer guides motions to a pose; without it they are not supported.
    """

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    def __init__(self, drivetrain: Drivetrain, context: PluginContext | None = None) -> None:
        self.drivetrain = drivetrain
        self._context = context
        self._speed_m_s = drivetrain.speed_m_s
        self._turn_rate_deg_s = drivetrain.turn_rate_deg_s
        self._step_m = 0.5
        self._twist_timeout_s = 0.5
        self._max_uncertainty_m = 0.3

    # Implemented by the driver.

    @abstractmethod
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        """Drive straight, from rest to rest.

        Args:
            distance_m: forward positive.
            speed_m_s: positive, within the drivetrain's.
        """

    @abstractmethod
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        """Turn in place, from rest to rest.

        Args:
            angle_rad: counter-clockwise positive.
            turn_rate_rad_s: positive, within the drivetrain's.
        """

    @abstractmethod
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        """Hold a twist, which is within the drivetrain's limits, until the time-out; then stop.

        Closing the activity leaves the wheels turning: a newer twist replaces it without a stop, a halt stops.

        Args:
            speed_m_s: forward positive.
            turn_rate_rad_s: counter-clockwise positive.
            timeout_s: how long, if no newer twist arrives.
        """

    def clearance_m(self, *, forward: bool) -> float:  # noqa: ARG002  # to be overridden
        """Return the free distance from the robot's outline to the nearest thing that its sensors see in its way.

        Motions to a pose stop before it. The default, infinity, is for a robot without such sensors.

        Args:
            forward: whether the robot drives forward; else back.

        Returns:
            Metres; 0 at a contact.
        """
        return math.inf

    @property
    @abstractmethod
    def calibration(self) -> WheelCalibration:
        """The calibration that motions and odometry use."""

    @calibration.setter
    @abstractmethod
    def calibration(self, calibration: WheelCalibration) -> None: ...

    def wheel_speeds_m_s(self, speed_m_s: float, turn_rate_rad_s: float) -> tuple[float, float]:
        """Return the counts per second of the left and the right wheel for a twist.

        If one exceeds its greatest speed, the same curve is driven slower.
        """
        left_m_s, right_m_s = self.calibration.counted(speed_m_s, turn_rate_rad_s * self.drivetrain.track_m / 2)
        excess = max(1.0, max(abs(left_m_s), abs(right_m_s)) / self.drivetrain.max_speed_m_s)
        return left_m_s / excess, right_m_s / excess

    # Inherited by the driver.

    @override
    def set_value(self, data: EALData) -> Activity:
        """Drive at a twist until a newer command, or until the time-out passes without one.

        Raises:
            ArgumentError: the twist is beyond the drivetrain's limits, or not finite.
        """
        speed_m_s, turn_rate_rad_s = (float(number) for number in data.value)
        self._check_reach("speed", speed_m_s, self.drivetrain.max_speed_m_s, "m/s")
        self._check_reach("turn rate", turn_rate_rad_s, math.radians(self.drivetrain.max_turn_rate_deg_s), "rad/s")
        return self.follow(speed_m_s, turn_rate_rad_s, self._twist_timeout_s)

    @command("g")
    def go(self) -> Activity:
        """Drive one step forward."""
        return self.drive(self._step_m, self._speed_m_s)

    @command("b")
    def back(self) -> Activity:
        """Drive one step back."""
        return self.drive(-self._step_m, self._speed_m_s)

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
        return self.drive(metres, self._speed_m_s)

    @command("b<metres>", _DISTANCE)
    def back_by(self, metres: float) -> Activity:
        """Drive back by a distance."""
        return self.drive(-metres, self._speed_m_s)

    @command("l<degrees>", _ANGLE)
    def left_by(self, degrees: float) -> Activity:
        """Turn left by an angle."""
        return self._turn(degrees)

    @command("r<degrees>", _ANGLE)
    def right_by(self, degrees: float) -> Activity:
        """Turn right by an angle."""
        return self._turn(-degrees)

    @command("goto", _GOAL)
    def go_to(self, goal: Any) -> Activity:
        """Drive to a place in the map frame; with a third number, turn to that heading there.

        Raises:
            ArgumentError: the goal is no [x_m, y_m] or [x_m, y_m, yaw_rad] of finite numbers.
            UnsupportedError: the driver estimates no pose.
        """
        numbers = [float(number) for number in goal]
        if len(numbers) not in (2, 3) or not all(map(math.isfinite, numbers)):
            raise ArgumentError(f"goto needs finite numbers x_m, y_m and perhaps yaw_rad, not {numbers}")
        return self._drive_route([(numbers[0], numbers[1])], numbers[2] if len(numbers) > 2 else None)

    @command("follow", _PATH)
    def follow_path(self, path: Any) -> Activity:
        """Drive along waypoints in the map frame to the last one; it turns in place at corners.

        Raises:
            ArgumentError: there is no waypoint, or a number is not finite.
            UnsupportedError: the driver estimates no pose.
        """
        numbers = path if isinstance(path, list | tuple) else path.ravel().tolist()
        points = [(float(x_m), float(y_m)) for x_m, y_m in zip(numbers[::2], numbers[1::2], strict=True)]
        if not points or not all(math.isfinite(number) for point in points for number in point):
            raise ArgumentError("follow needs at least one waypoint of finite numbers x_m, y_m")
        return self._drive_route(points, None)

    @config("speed_m_s", _SPEED)
    def speed_m_s(self) -> float:
        """Speed of driving straight."""
        return self._speed_m_s

    @config_setter("speed_m_s")
    def set_speed_m_s(self, speed_m_s: float) -> None:
        """Set the speed of later commands."""
        self._speed_m_s = float(speed_m_s)

    @config("turn_rate_deg_s", _TURN_RATE)
    def turn_rate_deg_s(self) -> float:
        """Speed of turning in place."""
        return self._turn_rate_deg_s

    @config_setter("turn_rate_deg_s")
    def set_turn_rate_deg_s(self, turn_rate_deg_s: float) -> None:
        """Set the turn rate of later commands."""
        self._turn_rate_deg_s = float(turn_rate_deg_s)

    @config("step_m", _STEP)
    def step_m(self) -> float:
        """Distance of the commands g and b."""
        return self._step_m

    @config_setter("step_m")
    def set_step_m(self, step_m: float) -> None:
        """Set the distance of later commands g and b."""
        self._step_m = float(step_m)

    @config("twist_timeout_s", _TWIST_TIMEOUT)
    def twist_timeout_s(self) -> float:
        """Time after which a twist ends if no newer one arrives."""
        return self._twist_timeout_s

    @config_setter("twist_timeout_s")
    def set_twist_timeout_s(self, twist_timeout_s: float) -> None:
        """Set the time-out of later twists."""
        self._twist_timeout_s = float(twist_timeout_s)

    @config("max_uncertainty_m", _UNCERTAINTY)
    def max_uncertainty_m(self) -> float:
        """Greatest standard deviation of the position with which it drives to a pose."""
        return self._max_uncertainty_m

    @config_setter("max_uncertainty_m")
    def set_max_uncertainty_m(self, max_uncertainty_m: float) -> None:
        """Set the limit for later motions to a pose."""
        self._max_uncertainty_m = float(max_uncertainty_m)

    @config("radius_m", _RADIUS)
    def radius_m(self) -> float:
        """Radius of the robot about its centre."""
        return self.drivetrain.radius_m

    @config("wheelbase_m", _TRACK)
    def wheelbase_m(self) -> float:
        """Nominal distance of the wheels."""
        return self.drivetrain.track_m

    @config("track_factor", _TRACK_FACTOR)
    def track_factor(self) -> float:
        """Effective over nominal distance of the wheels: E_b of the square test."""
        return self.calibration.track_factor

    @config_setter("track_factor")
    def set_track_factor(self, track_factor: float) -> None:
        """Set the factor for later commands, twists and the odometry."""
        self.calibration = self.calibration.model_copy(update={"track_factor": float(track_factor)})

    @config("wheel_ratio", _WHEEL_RATIO)
    def wheel_ratio(self) -> float:
        """Diameter of the right wheel over the left one's: E_d of the square test."""
        return self.calibration.wheel_ratio

    @config_setter("wheel_ratio")
    def set_wheel_ratio(self, wheel_ratio: float) -> None:
        """Set the ratio for later commands, twists and the odometry."""
        self.calibration = self.calibration.model_copy(update={"wheel_ratio": float(wheel_ratio)})

    def _turn(self, degrees: float) -> Activity:
        return self.turn(math.radians(degrees), math.radians(self._turn_rate_deg_s))

    def _drive_route(self, points: list[Point], yaw_rad: float | None) -> Activity:
        if self._context is None:
            raise UnsupportedError(
                f"the driver of the {self.drivetrain.name} estimates no pose, so it cannot drive to one"
            )
        clock, localizer = self._context.clock, self._context.localizer
        turn_rate_rad_s, arm_m = math.radians(self._turn_rate_deg_s), self.drivetrain.track_m / 2
        acceleration_m_s2 = self.drivetrain.acceleration_m_s2
        limits = MotionLimits(self._speed_m_s, turn_rate_rad_s, acceleration_m_s2, acceleration_m_s2 / arm_m)
        here = localizer.estimate(clock.now())
        controller = RouteController(Route([(here.x_m, here.y_m), *points]), yaw_rad, limits)
        device = MotionDevice(
            clock=clock,
            estimate=localizer.estimate,
            hold=self.follow,
            clearance_m=lambda forward: self.clearance_m(forward=forward),
            is_blocked=lambda: self.get_status() == BLOCKED,
            halt=self.halt,
            report=self.progress,
        )
        return ClosedLoop(device, controller, limits, self._max_uncertainty_m).run()

    def _check_reach(self, what: str, value: float, most: float, unit: str) -> None:
        if not abs(value) <= most + _ROUNDING:
            raise ArgumentError(
                f"the twist's {what} must be {-most:.4g}..{most:.4g} {unit}, "
                f"which the {self.drivetrain.name} reaches, not {value:g}"
            )

    @override
    def _make_info(self) -> ResourceInfo:
        """Return the information; the drivetrain sets the limits of the speeds."""
        info = super()._make_info()
        most = {"speed_m_s": self.drivetrain.max_speed_m_s, "turn_rate_deg_s": self.drivetrain.max_turn_rate_deg_s}
        configs = (
            replace(known, value=replace(known.value, maximum=most[known.name])) if known.name in most else known
            for known in info.configs
        )
        return replace(info, configs=tuple(configs))
