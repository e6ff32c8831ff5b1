"""The base of a simulated robot: it drives."""

from __future__ import annotations

from eal_actors.plugin import (
    Activity,
    DifferentialBase,
    Drivetrain,
    ResourceFaultError,
    UnavailableError,
    WheelCalibration,
)

from ..motion import Motion, Move
from ..robot import SimRobot
from ..world import SimWorld
from .ground import LOOK_S, minds_ground, require_ground
from .on_robot import OnRobot

_TELL_S = 0.5
_TELLS = 20
"""A motion tells how far it has come so often, but not at shorter intervals: each costs a crowd of robots a turn."""


class Base(DifferentialBase, OnRobot):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked.

    Args:
        world: the world that the robot is in.
        robot: the robot.
    """

    def __init__(self, world: SimWorld, robot: SimRobot) -> None:
        OnRobot.__init__(self, world, robot)
        make = robot.make
        speeds = make.speed_m_s, make.max_speed_m_s
        turn_rates = make.turn_rate_deg_s, make.max_turn_rate_deg_s
        DifferentialBase.__init__(self, Drivetrain(make.name, make.track_m, *speeds, *turn_rates))
        self._minds_ground = minds_ground(world, robot)

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

    @property
    def calibration(self) -> WheelCalibration:
        """See DifferentialBase."""
        return self._robot.calibration

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        with self._world.caught_up():
            self._robot.calibration = calibration

    # Motions.

    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        """See DifferentialBase."""
        move = Move.straight(self._robot.make, distance_m, speed_m_s, self._world.tick_s, self.calibration)
        return self._run(move, forward=distance_m > 0)

    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        """See DifferentialBase."""
        move = Move.turn(self._robot.make, angle_rad, turn_rate_rad_s, self._world.tick_s, self.calibration)
        return self._run(move, forward=False)

    def _run(self, move: Move, *, forward: bool) -> Activity:
        with self._world.caught_up():
            self._world.stop(self._robot)
            self._check_ground(forward)
            self._world.start(self._robot, move)
        tell_s = max(_TELL_S, move.remaining_s / _TELLS)
        try:
            while not move.is_over:
                yield min(self._until_look_s(move), tell_s)
                with self._world.caught_up():
                    self._check_going(move)
                    self._check_ground(forward)
                    self.progress(move.done_share)
            return 1
        finally:
            with self._world.caught_up():
                if self._robot.motion is move:
                    self._world.stop(self._robot)

    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        """See DifferentialBase.

        Raises:
            UnavailableError: the robot has no place in the world, or its battery is empty.
        """
        wheels_m_s = self.wheel_speeds_m_s(speed_m_s, turn_rate_rad_s)
        forward = speed_m_s > 0
        with self._world.caught_up():
            self._check_ground(forward)
            self._world.drive(self._robot, *wheels_m_s, timeout_s)
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
