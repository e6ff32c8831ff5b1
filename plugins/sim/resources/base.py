"""The base of a simulated robot: it drives."""

from __future__ import annotations

import math
from dataclasses import replace

from eal_actors.plugin import (
    Activity,
    ArgumentError,
    DataType,
    EALData,
    ResourceFaultError,
    ResourceInfo,
    ResourceType,
    UnavailableError,
    ValueInfo,
    WheelCalibration,
    command,
    config,
    config_setter,
)

from ..models import MAKES
from ..motion import Motion, Move
from ..robot import SimRobot
from ..world import SimWorld
from .ground import LOOK_S, minds_ground, require_ground
from .on_robot import OnRobot

_DISTANCE = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_SPEED = ValueInfo(DataType.DOUBLE, "m/s", 0.01, max(make.max_speed_m_s for make in MAKES.values()))
_TURN_RATE = ValueInfo(DataType.DOUBLE, "deg/s", 1, max(make.max_turn_rate_deg_s for make in MAKES.values()))
_TRACK_FACTOR = ValueInfo(DataType.DOUBLE, None, 0.5, 2, description="a factor; 1 is nominal")
_WHEEL_RATIO = ValueInfo(DataType.DOUBLE, None, 0.9, 1.1, description="a ratio; 1 is nominal")
_ROUNDING = 1e-9
_TELL_S = 0.5
"""How often at least a motion tells how far it has come."""


class Base(OnRobot):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked."""

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        super().__init__(world, robot)
        self._speed_m_s = robot.make.speed_m_s
        self._turn_rate_deg_s = robot.make.turn_rate_deg_s
        self._step_m = 0.5
        self._twist_timeout_s = 0.5
        self._minds_ground = minds_ground(world, robot)
        self._general_info: ResourceInfo | None = None
        self._own_info: ResourceInfo

    def info(self) -> ResourceInfo:
        """Return what it says of itself; speeds reach as far as the make does."""
        info = super().info()
        if info is not self._general_info:
            make = self._robot.make
            most = {"speed_m_s": make.max_speed_m_s, "turn_rate_deg_s": make.max_turn_rate_deg_s}
            configs = (
                replace(known, value=replace(known.value, maximum=most.get(known.name, known.value.maximum)))
                for known in info.configs
            )
            self._general_info, self._own_info = info, replace(info, configs=tuple(configs))
        return self._own_info

    def set_value(self, data: EALData) -> Activity:
        """Drive at a twist until a newer command, or until the time-out passes without one.

        Raises:
            ArgumentError: the make does not reach it, or it is no number.
            UnavailableError: the robot has no place in the world, or its battery is empty.
        """
        speed_m_s, turn_rate_rad_s = (float(part) for part in data.value)
        make = self._robot.make
        self._check_reach("speed", speed_m_s, make.max_speed_m_s, "m/s")
        self._check_reach("turn rate", turn_rate_rad_s, math.radians(make.max_turn_rate_deg_s), "rad/s")
        return self._follow(speed_m_s, turn_rate_rad_s)

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
        self._speed_m_s = float(speed_m_s)

    @config("turn_rate_deg_s", _TURN_RATE)
    def turn_rate_deg_s(self) -> float:
        """Speed of turning in place."""
        return self._turn_rate_deg_s

    @config_setter("turn_rate_deg_s")
    def set_turn_rate_deg_s(self, turn_rate_deg_s: float) -> None:
        """Set the turn rate of later commands."""
        self._turn_rate_deg_s = float(turn_rate_deg_s)

    @config("step_m", ValueInfo(DataType.DOUBLE, "m", 0.01, 10))
    def step_m(self) -> float:
        """Distance of the commands g and b."""
        return self._step_m

    @config_setter("step_m")
    def set_step_m(self, step_m: float) -> None:
        """Set the distance of later commands g and b."""
        self._step_m = float(step_m)

    @config("twist_timeout_s", ValueInfo(DataType.DOUBLE, "s", 0.1, 60))
    def twist_timeout_s(self) -> float:
        """Time after which a twist ends, if no newer one comes."""
        return self._twist_timeout_s

    @config_setter("twist_timeout_s")
    def set_twist_timeout_s(self, twist_timeout_s: float) -> None:
        """Set the time-out of later twists."""
        self._twist_timeout_s = float(twist_timeout_s)

    @config("wheelbase_m", ValueInfo(DataType.DOUBLE, "m", 0, 10))
    def wheelbase_m(self) -> float:
        """Nominal distance of the wheels."""
        return self._robot.make.track_m

    @config("track_factor", _TRACK_FACTOR)
    def track_factor(self) -> float:
        """Effective over nominal distance of the wheels: E_b of the square test."""
        return self._robot.calibration.track_factor

    @config_setter("track_factor")
    def set_track_factor(self, track_factor: float) -> None:
        """Set what later commands, twists and the odometry know of the distance of the wheels."""
        self._calibrate(track_factor=float(track_factor))

    @config("wheel_ratio", _WHEEL_RATIO)
    def wheel_ratio(self) -> float:
        """Diameter of the right wheel over the left one's: E_d of the square test."""
        return self._robot.calibration.wheel_ratio

    @config_setter("wheel_ratio")
    def set_wheel_ratio(self, wheel_ratio: float) -> None:
        """Set what later commands, twists and the odometry know of the wheels' diameters."""
        self._calibrate(wheel_ratio=float(wheel_ratio))

    def _calibrate(self, **change: float) -> None:
        with self._world.caught_up():
            known = self._robot.calibration
            self._robot.calibration = WheelCalibration.model_validate({**known.model_dump(), **change})

    def _check_reach(self, what: str, value: float, most: float, unit: str) -> None:
        if not abs(value) <= most + _ROUNDING:
            raise ArgumentError(
                f"the twist's {what} must be {-most:.4g}..{most:.4g} {unit}, "
                f"which the {self._robot.make.name} reaches, not {value:g}"
            )

    def _drive(self, distance_m: float) -> Activity:
        robot = self._robot
        move = Move.straight(robot.make, distance_m, self._speed_m_s, self._world.tick_s, robot.calibration)
        return self._run(move, forward=distance_m > 0)

    def _turn(self, degrees: float) -> Activity:
        rate_rad_s = math.radians(self._turn_rate_deg_s)
        robot = self._robot
        move = Move.turn(robot.make, math.radians(degrees), rate_rad_s, self._world.tick_s, robot.calibration)
        return self._run(move, forward=False)

    def _run(self, move: Move, *, forward: bool) -> Activity:
        with self._world.caught_up():
            self._world.stop(self._robot)
            self._check_ground(forward)
            self._world.start(self._robot, move)
        try:
            while not move.is_over:
                yield min(self._until_look_s(move), _TELL_S)
                with self._world.caught_up():
                    self._check_going(move)
                    self._check_ground(forward)
                    self.progress(move.done_share)
            return 1
        finally:
            with self._world.caught_up():
                if self._robot.motion is move:
                    self._world.stop(self._robot)

    def _follow(self, speed_m_s: float, turn_rate_rad_s: float) -> Activity:
        """Hold a twist. Closing it lets the wheels turn on: a newer twist takes over without a stop, a halt stops."""
        make = self._robot.make
        arm_m = turn_rate_rad_s * make.track_m / 2
        left_m_s, right_m_s = self._robot.calibration.counted(speed_m_s, arm_m)
        excess = max(1.0, abs(left_m_s) / make.max_speed_m_s, abs(right_m_s) / make.max_speed_m_s)
        forward = speed_m_s > 0
        with self._world.caught_up():
            self._check_ground(forward)
            self._world.drive(self._robot, left_m_s / excess, right_m_s / excess, self._twist_timeout_s)
            drive = self._robot.motion
        while drive is not None and not drive.is_over and self._robot.motion is drive:
            yield self._until_look_s(drive)
            with self._world.caught_up():
                self._check_going(drive)
                self._check_ground(forward)
        return 1

    def _until_look_s(self, motion: Motion) -> float:
        return min(motion.remaining_s, LOOK_S) if self._minds_ground else motion.remaining_s

    def _check_ground(self, forward: bool) -> None:
        """Stop the robot and raise ResourceFaultError where it would notice that the floor ends."""
        if not self._minds_ground:
            return
        try:
            require_ground(self._world, self._robot, forward=forward)
        except ResourceFaultError:
            self._world.stop(self._robot)
            raise

    def _check_going(self, motion: Motion) -> None:
        """Raise UnavailableError if the motion was cut short."""
        if self._robot.motion is None and not motion.is_over:
            why = "battery is empty" if self._robot.battery.is_empty else "its motors had no power for a while"
            raise UnavailableError(f"{why}: robot {self._robot.name!r} has stopped")
