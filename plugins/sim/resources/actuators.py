"""The actuators that move a simulated robot: its base and its turret."""

from __future__ import annotations

import math
from typing import Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    DifferentialBase,
    Drivetrain,
    EALData,
    PluginContext,
    ResourceFaultError,
    UnavailableError,
    UnsupportedError,
    WheelCalibration,
    slip_error,
    wrapped_rad,
)

from ...evbot3.turret import TurretCommands
from ...roomba.senses import ground_fault
from ..faults import HEALTHY
from ..motion import Move, WheelMotion
from ..robot import SimRobot
from ..sensors import dropped_wheels, free_way_m, pressed_bumpers, seen_cliffs
from ..world import SimWorld
from .robot_resource import RobotResource

_PROGRESS_S: Final = 0.5, 2.0
_PROGRESS_REPORTS: Final = 20
"""A motion reports its progress this often, but within `_PROGRESS_S` apart: each report costs a world step."""

_GROUND_POLL_S: Final = 0.05
"""Poll interval of the cliff sensors while the robot moves, as in a driver of a real robot."""


class Base(DifferentialBase, RobotResource):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked.

    Args:
        context: of the plugin, for motions to a pose.
    """

    def __init__(self, world: SimWorld, robot: SimRobot, context: PluginContext | None = None) -> None:
        RobotResource.__init__(self, world, robot)
        make = robot.make
        speeds = make.speed_m_s, make.max_speed_m_s
        turn_rates = make.turn_rate_deg_s, make.max_turn_rate_deg_s
        limits = *speeds, *turn_rates, make.acceleration_m_s2, make.radius_m
        DifferentialBase.__init__(self, Drivetrain(make.name, make.track_m, *limits), context)
        self._checks_ground = make.name == "roomba" and bool(world.model.drops)

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves, 2 while something blocks it."""
        with self._world.lock:
            self._world.catch_up()
            if self._robot.motion is None:
                return 0
            return 2 if self._robot.is_blocked else 1

    def halt(self) -> None:
        """Stop at once."""
        with self._world.lock:
            self._world.catch_up()
            self._world.stop(self._robot)

    @override
    def clearance_m(self, *, forward: bool) -> float:
        with self._world.lock:
            now_s = self._world.catch_up()
            if forward and any(pressed_bumpers(self._robot)):
                return 0.0
            return free_way_m(self._world, self._robot, now_s, forward=forward)

    @property
    @override
    def calibration(self) -> WheelCalibration:
        return self._robot.calibration

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        with self._world.lock:
            self._world.catch_up()
            self._robot.calibration = calibration

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        move = Move.straight(self._robot.make, distance_m, speed_m_s, self._world.tick_s, self.calibration)
        return self._run(move, forward=distance_m > 0)

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        move = Move.turn(self._robot.make, angle_rad, turn_rate_rad_s, self._world.tick_s, self.calibration)
        return self._run(move, forward=False)

    def _run(self, move: Move, *, forward: bool) -> Activity:
        with self._world.lock:
            self._world.catch_up()
            self._world.stop(self._robot)
            self._check_ground(forward)
            self._world.start(self._robot, move)
        report_s = sorted((*_PROGRESS_S, move.remaining_s / _PROGRESS_REPORTS))[1]
        try:
            while not move.is_over:
                yield min(self._poll_s(move), report_s)
                with self._world.lock:
                    self._world.catch_up()
                    self._check_motion(move, forward)
                    self._check_ground(forward)
                    self.progress(move.done_share)
            return 1
        finally:
            with self._world.lock:
                self._world.catch_up()
                if self._robot.motion is move:
                    self._world.stop(self._robot)

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        wheels_m_s = self.wheel_speeds_m_s(speed_m_s, turn_rate_rad_s)
        forward = speed_m_s > 0
        with self._world.lock:
            self._world.catch_up()
            self._check_ground(forward)
            self._world.drive(self._robot, *wheels_m_s, timeout_s)
            motion = self._robot.motion
        while motion is not None and not motion.is_over and self._robot.motion is motion:
            yield self._poll_s(motion)
            with self._world.lock:
                self._world.catch_up()
                self._check_motion(motion, forward)
                self._check_ground(forward)
        return 1

    def _poll_s(self, motion: WheelMotion) -> float:
        return min(motion.remaining_s, _GROUND_POLL_S) if self._checks_ground else motion.remaining_s

    def _check_ground(self, forward: bool) -> None:
        """Stop the robot and raise ResourceFaultError if its sensors find a drop. Thread: holds the world's `lock`.

        A robot with cliff sensors halts by itself, as the driver of the real robot does.

        Raises:
            ResourceFaultError: a wheel has dropped, or a cliff is ahead of a forward motion.
            UnavailableError: the robot has no place in the world.
        """
        if not self._checks_ground:
            return
        drops, cliffs = dropped_wheels(self._world, self._robot), seen_cliffs(self._world, self._robot)
        if (fault := ground_fault(drops, cliffs, forward=forward)) is not None:
            self._world.stop(self._robot)
            raise fault

    def _check_motion(self, motion: WheelMotion, forward: bool) -> None:
        """Stop a robot with a stalled wheel, as the firmware of the real robots does.

        Raises:
            BlockedError: something holds the robot.
            ResourceFaultError: a wheel is stalled.
            UnavailableError: the motion was cut short.
        """
        faults = self._robot.faults
        if faults is not HEALTHY and (stalled := faults.stalled_wheels(forward=forward)):
            self._world.stop(self._robot)
            raise ResourceFaultError(f"halted: the {stalled} wheel was driven, but its encoder counted nothing")
        if self._robot.slipped_m > motion.most_slip_m:
            raise slip_error(self._robot.slipped_m)
        if self._robot.motion is None and not motion.is_over:
            reason = "battery is empty" if self._robot.battery.is_empty else "its motors had no power for a while"
            raise UnavailableError(f"{reason}: robot {self._robot.name!r} has stopped")


class Turret(TurretCommands, RobotResource):
    """Turns on the robot; get_status: 0 rests, 1 turns; get_value: its angle in rad, to the left of straight ahead.

    Raises:
        UnsupportedError: the make has no turret.
    """

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        RobotResource.__init__(self, world, robot)
        if robot.turret is None:
            raise UnsupportedError(f"robot {robot.name!r} is an {robot.make.name}, which has no turret")
        self._turret = robot.turret
        TurretCommands.__init__(self, robot.turret.model.turn_rate_deg_s)

    def get_status(self) -> int:
        """Return 0 while it rests, 1 while it turns."""
        return 1 if self._remaining_s() else 0

    def get_value(self) -> EALData:
        """Return its angle relative to the robot, in (-pi, pi]."""
        return self._read(lambda _: wrapped_rad(self._turret.yaw_rad), "rad", "base")

    def halt(self) -> None:
        """Stop at once."""
        with self._world.lock:
            self._world.catch_up()
            self._turret.stop()

    @override
    def swing(self, degrees: float) -> Activity:
        return self._turn(math.radians(degrees))

    @override
    def aim(self, degrees: float) -> Activity:
        with self._world.lock:
            self._world.catch_up()
            angle_rad = wrapped_rad(math.radians(degrees) - self._turret.yaw_rad)
        return self._turn(angle_rad)

    def _turn(self, angle_rad: float) -> Activity:
        with self._world.lock:
            self._world.catch_up()
            self._turret.turn(angle_rad, math.radians(self.turn_rate_deg_s))
        try:
            while remaining_s := self._remaining_s():
                yield remaining_s
            return 1
        finally:
            self.halt()

    def _remaining_s(self) -> float:
        with self._world.lock:
            self._world.catch_up()
            return self._turret.remaining_s
