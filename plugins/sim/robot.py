"""One simulated robot: where it is, the motion it carries out, its encoders, battery and turret."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable

import numpy as np
import pymunk

from eal_actors.plugin import UnavailableError, WheelCalibration

from .arena import Pose
from .battery import Battery
from .faults import HEALTHY, FaultSet
from .models import Make
from .motion import Drive, Motion
from .turret import Turret
from .view import View
from .wheels import DeadReckoning, Wheels, moved


class SimRobot:
    """A disc that is driven by two wheels, or stands with its brakes on.

    Args:
        name: the robot's name.
        make: its make.
        noise: whether its wheels have the errors of its make.
        group: over 0, its own in the world: its rays do not see itself.
        seed: the fleet's seed.
        tick_s: length of a physics tick.
        now_s: tells the world's time, in seconds.
        charge: how full its battery is at first, 0..1.

    Attributes:
        motion: what it carries out; None while it stands.
        next_pose: where it will be after the present tick, if nothing is in its way.
        clear_until_tick: until this tick of the world, it can touch nothing.
        tick_s: length of a physics tick.
        odometer: follows the encoders, if somebody wants it to.
        calibration: what its base and its odometer know of its wheels.
        turret: its turret, if it has one.
        sensor_generator: the source of all noise of its sensors.

    Thread: every member is for the holder of the world's lock.
    """

    def __init__(
        self,
        name: str,
        make: Make,
        *,
        noise: bool,
        group: int,
        seed: int,
        tick_s: float,
        now_s: Callable[[], float],
        charge: float = 1.0,
    ) -> None:
        self.name = name
        self.make = make
        self.noise = noise
        self.filter = pymunk.ShapeFilter(group=group)
        self.motion: Motion | None = None
        self.next_pose: Pose = (0.0, 0.0, 0.0)
        self.clear_until_tick = 0
        self.odometer: DeadReckoning | None = None
        self.calibration = WheelCalibration()
        self.turret = Turret(make.turret, now_s) if make.turret else None
        name_seed = zlib.crc32(name.encode())
        motion_generator, self.sensor_generator = (np.random.default_rng([seed, name_seed, use]) for use in range(2))
        self._wheels = Wheels(make if noise else make.without_errors(), motion_generator, tick_s)
        self._battery = Battery(make.battery, charge)
        self.tick_s = tick_s
        self._faults = HEALTHY
        self._now_s = now_s
        self._pose: Pose | None = None
        self._view: View | None = None
        self._command_m = self._gone = self._wanted = (0.0, 0.0)

    @property
    def space(self) -> pymunk.Space:
        """A space that shows where everything is now: for looking, not for changing.

        Raises:
            UnavailableError: it has no place in the world.
        """
        if self._view is None:
            raise self._no_place()
        return self._view.space

    @property
    def pose(self) -> Pose:
        """Its true x and y in metres and yaw in radians, unwrapped, in the world's frame.

        Raises:
            UnavailableError: it has no place in the world.
        """
        if self._pose is None:
            raise self._no_place()
        return self._pose

    @property
    def is_placed(self) -> bool:
        """Whether it has a place in the world."""
        return self._pose is not None

    @property
    def is_blocked(self) -> bool:
        """Whether it moves at less than half the speed it is driven at."""
        arm_m = self.make.track_m / 2
        wanted, gone = (abs(ahead_m) + abs(turn_rad) * arm_m for ahead_m, turn_rad in (self._wanted, self._gone))
        stands = gone == 0.0 and any(self._command_m)  # with both wheels stuck it is not even wanted to move
        return self.motion is not None and (gone < wanted / 2 or stands)

    @property
    def travel_m(self) -> tuple[float, float]:
        """What the left and the right encoder have counted since it joined, in whole steps."""
        return self._wheels.counted_m

    @property
    def wheel_speeds_m_s(self) -> tuple[float, float]:
        """What the left and the right wheel are commanded at this moment."""
        if self.motion is None:
            return 0.0, 0.0
        left_m, right_m = self._command_m
        return left_m / self.tick_s, right_m / self.tick_s

    @property
    def battery(self) -> Battery:
        """Its battery at this moment."""
        left_m_s, right_m_s = self.wheel_speeds_m_s
        self._battery.follow(self._now_s(), self._wheels.turned_m, (abs(left_m_s) + abs(right_m_s)) / 2)
        return self._battery

    @property
    def faults(self) -> FaultSet:
        """What is wrong with it on purpose. Thread: any, for reading."""
        return self._faults

    @faults.setter
    def faults(self, faults: FaultSet) -> None:
        self._faults = faults
        self._wheels.shares = faults.wheel_shares
        self._battery.has_failed = faults.battery_empty

    @property
    def is_dead(self) -> bool:
        """Whether it is off: it does nothing and answers nothing. Thread: any."""
        return self._faults.dead

    @property
    def turret_yaw_rad(self) -> float:
        """Its turret's angle, counter-clockwise from straight ahead, unwrapped; 0 without a turret."""
        return self.turret.yaw_rad if self.turret else 0.0

    def place(self, view: View, pose: Pose) -> None:
        """Put it into the world, standing."""
        self._view = view
        self._pose = pose

    def start(self, motion: Motion) -> None:
        """Release the brakes and begin a motion.

        Raises:
            UnavailableError: it has no place in the world, or its battery is empty, or it is dead.
        """
        if self._pose is None:
            raise self._no_place()
        if self.is_dead:
            raise UnavailableError(f"robot {self.name!r} is dead")
        if self.battery.is_empty:
            raise UnavailableError(f"battery is empty: robot {self.name!r} cannot drive")
        if not (isinstance(self.motion, Drive) and isinstance(motion, Drive)):
            self._wheels.start(motion)
        self.motion = motion

    def stop(self) -> None:
        """Put the brakes on: it stands at once."""
        self.motion = None
        self._command_m = self._gone = self._wanted = (0.0, 0.0)

    def predict(self) -> None:
        """Turn its wheels for one tick, and work out where it will be then if nothing is in its way."""
        if self.motion is None or self._pose is None:
            return
        self._command_m = self.motion.step()
        ahead_m, turn_rad = self._wanted = self._wheels.travel(*self._command_m)
        if self.odometer is not None:
            self.odometer.follow(self._wheels.counted_m, self.calibration)
        self.next_pose = moved(self._pose, ahead_m, turn_rad)

    def drive_on(self, tick: int, ticks: int) -> None:
        """Drive for some ticks from a tick of the world on with nothing in the way, or until the motion is done."""
        for after in range(tick + 1, tick + ticks + 1):
            self.predict()
            self.arrive(self.next_pose)
            if self.is_done(after * self.tick_s):
                return

    def is_done(self, now_s: float) -> bool:
        """Return whether its motion is over, or its battery empty, when the world's time is `now_s` seconds."""
        if self.motion is None or self.motion.is_over:
            return True
        return self._battery.is_empty_after(now_s, self._wheels.turned_m)

    def arrive(self, pose: Pose) -> None:
        """Take a pose at the end of a tick."""
        if pose is self.next_pose:
            self._gone = self._wanted
        else:
            x_m, y_m, yaw_rad = self.pose
            self._gone = math.hypot(pose[0] - x_m, pose[1] - y_m), pose[2] - yaw_rad
        self._pose = pose

    def _no_place(self) -> UnavailableError:
        return UnavailableError(f"the simulated world has no free place for robot {self.name!r}")
