"""The base of most robots on a floor: two driven wheels or tracks, and the commands of the thesis's experiments.

A driver implements three motions and inherits the rest: the commands with their units and ranges, the configuration
keys and the argument checks. So a controller finds the same `Base` on each robot.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Annotated, Final

from pydantic import Field
from typing_extensions import override

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceInfo, ResourceType, ValueInfo
from eal_actors.device.motion.map_motions import MapMotions
from eal_actors.device.motion.route_controller import MotionLimits
from eal_actors.device.plugin_context import PluginContext, PluginSettingsModel
from eal_actors.device.resource import Activity, command, config, config_setter, setting
from eal_actors.kernel.errors import ArgumentError, UnsupportedError
from eal_actors.kernel.strict_model import StrictModel

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
_ROUNDING: Final = 1e-9


Radius = Annotated[float, Field(gt=0, le=10)]
Speed = Annotated[float, Field(gt=0, le=30)]
TurnRate = Annotated[float, Field(gt=0, le=1000)]


class WheelCalibration(StrictModel):
    """The deviation of a robot's wheels from their nominal sizes, in the terms of Borenstein and Feng.

    A base commands its wheels and computes its odometry by it, so that distances and angles come out true.
    With both factors at 1, nothing changes, not even by a rounding.
    """

    track_factor: float = Field(default=1.0, ge=0.5, le=2.0)
    """E_b: effective over nominal distance of the wheels; over 1 the robot turns too little."""
    wheel_ratio: float = Field(default=1.0, ge=0.9, le=1.1)
    """E_d: diameter of the right wheel over the left one's; over 1 the robot drifts to the left."""

    @property
    def left_factor(self) -> float:
        """c_L: travel of the left wheel per metre counted."""
        return 2.0 / (self.wheel_ratio + 1.0)

    @property
    def right_factor(self) -> float:
        """c_R: travel of the right wheel per metre counted; the mean of both is 1."""
        return 2.0 / (1.0 / self.wheel_ratio + 1.0)

    def counted(self, ahead: float, arc: float) -> tuple[float, float]:
        """Return the counts of the left and the right wheel for a motion.

        Args:
            ahead: distance or speed of the robot's centre.
            arc: the angle to the left, or its rate, times half the nominal distance of the wheels; in the unit of
                `ahead`.
        """
        arm = arc * self.track_factor
        return (ahead - arm) / self.left_factor, (ahead + arm) / self.right_factor

    def travelled(self, left: float, right: float) -> tuple[float, float]:
        """Return the motion for the counts of the wheels: distance ahead, and arc to the left. Inverts `counted`."""
        left, right = left * self.left_factor, right * self.right_factor
        return (left + right) / 2, (right - left) / 2 / self.track_factor


NOMINAL: Final = WheelCalibration()
"""The calibration of wheels of exactly their nominal sizes."""


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """The abilities of the wheels and motors of a type of robot.

    Attributes:
        track_m: nominal distance of its wheels.
        max_speed_m_s: greatest speed, of each wheel too.
        acceleration_m_s2: of each wheel, in motions to a place.
        radius_m: of the smallest disc about the robot's centre that it fits in.
    """

    name: str
    track_m: float
    speed_m_s: float
    max_speed_m_s: float
    turn_rate_deg_s: float
    max_turn_rate_deg_s: float
    acceleration_m_s2: float = 0.4
    radius_m: float = 0.2


class MobileBaseSettings(PluginSettingsModel):
    """The settings of a robot whose size and speeds the driver cannot know."""

    radius_m: Radius = 0.3
    """Radius of the robot about its centre."""
    speed_m_s: Speed = 0.5
    """Usual speed."""
    max_speed_m_s: Speed = 1.5
    """Greatest speed."""
    turn_rate_deg_s: TurnRate = 45.0
    """Usual turn rate."""
    max_turn_rate_deg_s: TurnRate = 120.0
    """Greatest turn rate."""

    def drivetrain(self, name: str, track_m: float, acceleration_m_s2: float = 0.4) -> Drivetrain:
        """Return the drivetrain; `name` is for messages, and the acceleration is that of each wheel."""
        own = self.model_dump(include=set(MobileBaseSettings.model_fields))
        return Drivetrain(name=name, track_m=track_m, acceleration_m_s2=acceleration_m_s2, **own)


class DifferentialBase(MapMotions):
    """Drives a robot with two driven wheels (Source: thesis §6.2.1, §6.2.2).

    A driver implements `drive`, `turn` and `follow`, `halt` and `get_status`; the property `calibration`, unless the
    robot calibrates its own wheels; and `clearance_m`, if it has sensors for it. `context` is the plugin's; its
    localizer guides motions to a place, which without it are not supported.
    """

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    speed_m_s: float = setting(_SPEED, "Speed of driving straight.")
    turn_rate_deg_s: float = setting(_TURN_RATE, "Speed of turning in place.")
    step_m: float = setting(_STEP, "Distance of the commands g and b.")
    twist_timeout_s: float = setting(_TWIST_TIMEOUT, "Time after which a twist ends if no newer one arrives.")

    def __init__(self, drivetrain: Drivetrain, context: PluginContext | None = None) -> None:
        MapMotions.__init__(self, context)  # not `super`: a driver's other bases have arguments of their own
        self.drivetrain = drivetrain
        self.speed_m_s = drivetrain.speed_m_s
        self.turn_rate_deg_s = drivetrain.turn_rate_deg_s
        self.step_m = 0.5
        self.twist_timeout_s = 0.5

    # Implemented by the driver.

    @abstractmethod
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        """Drive straight from rest to rest, ahead if the distance is positive, at a speed within the drivetrain's."""

    @abstractmethod
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        """Turn in place from rest to rest, to the left if the angle is positive, at a rate within the drivetrain's."""

    @property
    def calibration(self) -> WheelCalibration:
        """The calibration that motions and odometry use. The default is for a robot that calibrates its own wheels."""
        return NOMINAL

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        if calibration != NOMINAL:
            raise UnsupportedError(f"a robot of type {self.drivetrain.name} calibrates its own wheels, in its driver")

    def wheel_speeds_m_s(self, speed_m_s: float, turn_rate_rad_s: float) -> tuple[float, float]:
        """Return the counts per second of the left and the right wheel for a twist.

        If one exceeds its greatest speed, the same curve is driven slower.
        """
        left_m_s, right_m_s = self.calibration.counted(speed_m_s, turn_rate_rad_s * self.drivetrain.track_m / 2)
        excess = max(1.0, max(abs(left_m_s), abs(right_m_s)) / self.drivetrain.max_speed_m_s)
        return left_m_s / excess, right_m_s / excess

    # Inherited by the driver.

    @override
    def motion_limits(self) -> MotionLimits:
        acceleration_m_s2, arm_m = self.drivetrain.acceleration_m_s2, self.drivetrain.track_m / 2
        turn_rate_rad_s = math.radians(self.turn_rate_deg_s)
        return MotionLimits(self.speed_m_s, turn_rate_rad_s, acceleration_m_s2, acceleration_m_s2 / arm_m)

    @override
    def set_value(self, data: EALData) -> Activity:
        """Drive at a twist until a newer command, or until the time-out passes without one.

        Raises ArgumentError if the twist is beyond the drivetrain's limits, or not finite.
        """
        speed_m_s, turn_rate_rad_s = (float(number) for number in data.value)
        self._check_reach("speed", speed_m_s, self.drivetrain.max_speed_m_s, "m/s")
        self._check_reach("turn rate", turn_rate_rad_s, math.radians(self.drivetrain.max_turn_rate_deg_s), "rad/s")
        return self.follow(speed_m_s, turn_rate_rad_s, self.twist_timeout_s)

    @command("g")
    def go(self) -> Activity:
        """Drive one step forward."""
        return self.drive(self.step_m, self.speed_m_s)

    @command("b")
    def back(self) -> Activity:
        """Drive one step back."""
        return self.drive(-self.step_m, self.speed_m_s)

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
        return self.drive(metres, self.speed_m_s)

    @command("b<metres>", _DISTANCE)
    def back_by(self, metres: float) -> Activity:
        """Drive back by a distance."""
        return self.drive(-metres, self.speed_m_s)

    @command("l<degrees>", _ANGLE)
    def left_by(self, degrees: float) -> Activity:
        """Turn left by an angle."""
        return self._turn(degrees)

    @command("r<degrees>", _ANGLE)
    def right_by(self, degrees: float) -> Activity:
        """Turn right by an angle."""
        return self._turn(-degrees)

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
        return self.turn(math.radians(degrees), math.radians(self.turn_rate_deg_s))

    def _check_reach(self, what: str, value: float, most: float, unit: str) -> None:
        if not abs(value) <= most + _ROUNDING:
            raise ArgumentError(
                f"the twist's {what} must be {-most:.4g}..{most:.4g} {unit}, "
                f"which the {self.drivetrain.name} reaches, not {value:g}"
            )

    @override
    def _make_info(self) -> ResourceInfo:
        """Return the information; the drivetrain sets the limits of the speeds and the durations of motions."""
        info = super()._make_info()
        most = {"speed_m_s": self.drivetrain.max_speed_m_s, "turn_rate_deg_s": self.drivetrain.max_turn_rate_deg_s}
        configs = (
            replace(known, value=replace(known.value, maximum=most[known.name])) if known.name in most else known
            for known in info.configs
        )
        paces = {_DISTANCE: "speed_m_s", _ANGLE: "turn_rate_deg_s"}
        commands = (
            replace(known, pace=paces.get(known.argument, "")) if known.argument else known for known in info.commands
        )
        info = replace(info, commands=tuple(commands), configs=tuple(configs))
        return info.at_pace("speed_m_s", self.speed_m_s).at_pace("turn_rate_deg_s", self.turn_rate_deg_s)
