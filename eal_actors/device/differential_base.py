"""The base that most robots on a floor have: two driven wheels or tracks, and the commands of the thesis's experiments.

A driver's own class carries out three motions, and inherits the rest: the commands with their units and ranges, the
configuration keys, and the checks of what is asked for. So a controller finds the same `Base` on each of them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Final

from eal_actors.device.data import DataType, EALData
from eal_actors.device.info import ResourceInfo, ResourceType, ValueInfo
from eal_actors.device.resource import Activity, Resource, command, config, config_setter
from eal_actors.device.wheels import WheelCalibration
from eal_actors.kernel.errors import ArgumentError

_DISTANCE: Final = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_SPEED: Final = ValueInfo(DataType.DOUBLE, "m/s", 0.01)  # the greatest is the drivetrain's, see _make_info
_TURN_RATE: Final = ValueInfo(DataType.DOUBLE, "deg/s", 1)
_STEP: Final = ValueInfo(DataType.DOUBLE, "m", 0.01, 10)
_TWIST_TIMEOUT: Final = ValueInfo(DataType.DOUBLE, "s", 0.1, 60)
_TRACK: Final = ValueInfo(DataType.DOUBLE, "m", 0, 10)
_TRACK_FACTOR: Final = ValueInfo(DataType.DOUBLE, None, 0.5, 2, description="a factor; 1 is nominal")
_WHEEL_RATIO: Final = ValueInfo(DataType.DOUBLE, None, 0.9, 1.1, description="a ratio; 1 is nominal")
_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True)
class Drivetrain:
    """What the wheels and motors of a make of robot can do.

    Attributes:
        name: of the make, for messages.
        track_m: nominal distance of its wheels.
        speed_m_s: speed at first.
        max_speed_m_s: greatest speed, of each wheel too.
        turn_rate_deg_s: turn rate at first.
        max_turn_rate_deg_s: greatest turn rate.
    """

    name: str
    track_m: float
    speed_m_s: float
    max_speed_m_s: float
    turn_rate_deg_s: float
    max_turn_rate_deg_s: float


class DifferentialBase(Resource, ABC):
    """Drives a robot with two driven wheels (Source: thesis §6.2.1, §6.2.2).

    A driver implements `drive`, `turn` and `follow`, the property `calibration`, `halt` and `get_status`.

    Args:
        drivetrain: what it drives.
    """

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    def __init__(self, drivetrain: Drivetrain) -> None:
        self.drivetrain = drivetrain
        self._speed_m_s = drivetrain.speed_m_s
        self._turn_rate_deg_s = drivetrain.turn_rate_deg_s
        self._step_m = 0.5
        self._twist_timeout_s = 0.5

    # What a driver adds.

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
        """Hold a twist, which the drivetrain reaches, until the time-out; then stop.

        Closing the activity leaves the wheels turning: a newer twist takes over without a stop, a halt stops.

        Args:
            speed_m_s: forward positive.
            turn_rate_rad_s: counter-clockwise positive.
            timeout_s: how long, if no newer twist comes.
        """

    @property
    @abstractmethod
    def calibration(self) -> WheelCalibration:
        """What motions and odometry know of the wheels."""

    @calibration.setter
    @abstractmethod
    def calibration(self, calibration: WheelCalibration) -> None: ...

    def wheel_speeds_m_s(self, speed_m_s: float, turn_rate_rad_s: float) -> tuple[float, float]:
        """Return what the left and the right wheel have to count in a second for a twist.

        Where one would have to go too fast, it is the same curve, driven slower.
        """
        left_m_s, right_m_s = self.calibration.counted(speed_m_s, turn_rate_rad_s * self.drivetrain.track_m / 2)
        excess = max(1.0, max(abs(left_m_s), abs(right_m_s)) / self.drivetrain.max_speed_m_s)
        return left_m_s / excess, right_m_s / excess

    # What it brings.

    def set_value(self, data: EALData) -> Activity:
        """Drive at a twist until a newer command, or until the time-out passes without one.

        Raises:
            ArgumentError: the robot does not reach it, or it is no number.
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
        """Time after which a twist ends, if no newer one comes."""
        return self._twist_timeout_s

    @config_setter("twist_timeout_s")
    def set_twist_timeout_s(self, twist_timeout_s: float) -> None:
        """Set the time-out of later twists."""
        self._twist_timeout_s = float(twist_timeout_s)

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
        """Set what later commands, twists and the odometry know of the distance of the wheels."""
        self.calibration = self.calibration.model_copy(update={"track_factor": float(track_factor)})

    @config("wheel_ratio", _WHEEL_RATIO)
    def wheel_ratio(self) -> float:
        """Diameter of the right wheel over the left one's: E_d of the square test."""
        return self.calibration.wheel_ratio

    @config_setter("wheel_ratio")
    def set_wheel_ratio(self, wheel_ratio: float) -> None:
        """Set what later commands, twists and the odometry know of the wheels' diameters."""
        self.calibration = self.calibration.model_copy(update={"wheel_ratio": float(wheel_ratio)})

    def _turn(self, degrees: float) -> Activity:
        return self.turn(math.radians(degrees), math.radians(self._turn_rate_deg_s))

    def _check_reach(self, what: str, value: float, most: float, unit: str) -> None:
        if not abs(value) <= most + _ROUNDING:
            raise ArgumentError(
                f"the twist's {what} must be {-most:.4g}..{most:.4g} {unit}, "
                f"which the {self.drivetrain.name} reaches, not {value:g}"
            )

    def _make_info(self) -> ResourceInfo:
        """Return what it says of itself; speeds reach as far as the drivetrain does."""
        info = super()._make_info()
        most = {"speed_m_s": self.drivetrain.max_speed_m_s, "turn_rate_deg_s": self.drivetrain.max_turn_rate_deg_s}
        configs = (
            replace(known, value=replace(known.value, maximum=most[known.name])) if known.name in most else known
            for known in info.configs
        )
        return replace(info, configs=tuple(configs))
