"""One simulated robot: its pose, motion, encoders and faults."""

from __future__ import annotations

import math
import types
import zlib
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import pymunk
from typing_extensions import override

from eal_actors.plugin import Activity, Localizer, ResourceFaultError, UnavailableError, WheelCalibration

from .arena import Pose2D, QuerySpace
from .faults import HEALTHY, FaultSet
from .free_robots import FreeRobot, FreeRobots, FreeState
from .models import Make
from .motion import NormalNumbers, SimWheels, WheelMotion, WheelOdometer, moved
from .parts import SimBattery, SimTurret
from .velocity_drive import VelocityDrive

_CLOSE_S: Final = 0.019
"""A pose estimate replaces a note that is closer to the one before, such as that of a reading, by the next one."""
_MOST_REPORTS: Final = 512
"""Notes after which the pose estimate hears of them; it does before somebody reads it too."""
_REVIVAL_POLL_S: Final = 60.0
"""Poll interval of an interrupted activity of a dead robot, until the robot is alive again."""


class SimRobot(FreeRobot):
    """A disc that is driven by two wheels, or stands with its brakes on.

    Args:
        noise: whether its wheels have the errors of its make.
        group: collision group, over 0 and unique in the world: queries skip the robot's own shape.
        now_s: returns the world's time, in seconds.
        charge: initial charge of its battery, 0..1.
        joined_s: the world's time at which it has that charge.

    Attributes:
        next_pose: its pose after the present tick, if nothing is in its way.
        clear_until_tick: it cannot touch anything before this tick of the world.
        localizer: its pose estimate, once a Pose resource exists.
        slipped_m: how far its wheels have turned in vain since its motion began.
        report_ticks: it notes its odometry for the pose estimate every so many ticks while driven: often enough that
            readings in between leave no trace in later estimates.

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
        joined_s: float = 0.0,
    ) -> None:
        self.name = name
        self.make = make
        self.noise = noise
        self.filter = pymunk.ShapeFilter(group=group)
        self._motion: WheelMotion | None = None
        self.next_pose: Pose2D = (0.0, 0.0, 0.0)
        self.clear_until_tick = 0
        self._odometer: WheelOdometer | None = None
        self._calibration = WheelCalibration()
        self.localizer: Localizer | None = None
        self._reports: list[tuple[float, float, float, float]] = []
        self.turret = SimTurret(make.turret, now_s) if make.turret else None
        self._seeds = seed, zlib.crc32(name.encode())
        motion_generator, self.sensor_generator = (np.random.default_rng([*self._seeds, use]) for use in range(2))
        self._wheels = SimWheels(make if noise else make.without_errors(), motion_generator)
        self._battery = SimBattery(make.battery, charge, joined_s)
        self.tick_s = tick_s
        self.report_ticks: Final = 2 if tick_s < _CLOSE_S else 1
        self._faults = HEALTHY
        self._now_s = now_s
        self._pose: Pose2D | None = None
        self._last_pose = self._pose_before_last = self.next_pose
        self._queries: QuerySpace | None = None
        self._command_m = self._gone = self._wanted = (0.0, 0.0)
        self.slipped_m = 0.0

    @property
    def space(self) -> pymunk.Space:
        """A space with the current places of everything, for queries only.

        Raises:
            UnavailableError: it has no place in the world.
        """
        if self._queries is None:
            raise self._no_place()
        return self._queries.space

    @property
    def pose(self) -> Pose2D:
        """Its true x and y in metres and yaw in radians, unwrapped, in the world's frame.

        Raises:
            UnavailableError: it has no place in the world.
        """
        if self.free is not None:
            return self.free.pose_of(self)
        if self._pose is None:
            raise self._no_place()
        return self._pose

    @property
    def motion(self) -> WheelMotion | None:
        """The running motion; None while it stands."""
        self._update()
        return self._motion

    @property
    def odometry(self) -> Pose2D:
        """Its pose by dead reckoning since `begin_odometry`."""
        self._update()
        return self._odometer.pose if self._odometer is not None else (0.0, 0.0, 0.0)

    @odometry.setter
    def odometry(self, pose: Pose2D) -> None:
        self.leave()
        if self._odometer is not None:
            self._odometer.pose = pose

    def begin_odometry(self) -> None:
        """Begin dead reckoning at (0, 0, 0), unless it has begun."""
        self.leave()
        if self._odometer is None:
            self._odometer = WheelOdometer(self.make.track_m, self._wheels.counted_m)

    @property
    def calibration(self) -> WheelCalibration:
        """The wheel calibration used by its base and its odometry."""
        return self._calibration

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        self.leave()
        self._calibration = calibration

    @property
    def has_place(self) -> bool:
        """Whether it has a place in the world."""
        return self._pose is not None

    @property
    def recent_poses(self) -> tuple[Pose2D, Pose2D, Pose2D]:
        """Its poses at the last three ticks, the present one last; all the same while it stands.

        Raises:
            UnavailableError: it has no place in the world.
        """
        self._update()
        pose = self.pose
        return (self._pose_before_last, self._last_pose, pose) if self._motion is not None else (pose, pose, pose)

    def noise_source(self, sensor: str) -> np.random.Generator:
        """Return a new generator of the noise of one sensor: no other sensor can change its numbers."""
        return np.random.default_rng([*self._seeds, zlib.crc32(sensor.encode())])

    @property
    @override
    def normals(self) -> NormalNumbers:
        return self._wheels.normals

    @property
    def is_blocked(self) -> bool:
        """Whether it moves at less than half its commanded speed."""
        self._update()
        arm_m = self.make.track_m / 2
        wanted, gone = (abs(ahead_m) + abs(turn_rad) * arm_m for ahead_m, turn_rad in (self._wanted, self._gone))
        stands = gone == 0.0 and any(self._command_m)  # with both wheels stuck, `wanted` is 0 as well
        return self._motion is not None and (gone < wanted / 2 or stands)

    @property
    def travel_m(self) -> tuple[float, float]:
        """The totals of the left and the right encoder since it joined, in whole steps."""
        self._update()
        return self._wheels.counted_m

    @property
    def wheel_speeds_m_s(self) -> tuple[float, float]:
        """The commanded speeds of the left and the right wheel at this moment."""
        self._update()
        left_m, right_m = self._command_m  # 0 while it stands
        return left_m / self.tick_s, right_m / self.tick_s

    @property
    def battery(self) -> SimBattery:
        """Its battery at this moment."""
        left_m_s, right_m_s = self.wheel_speeds_m_s
        self._battery.follow(self._now_s(), self._wheels.turned_m, (abs(left_m_s) + abs(right_m_s)) / 2)
        return self._battery

    @property
    def faults(self) -> FaultSet:
        """Its injected faults. Thread: any, for reading."""
        return self._faults

    @faults.setter
    def faults(self, faults: FaultSet) -> None:
        self.leave()
        self._faults = faults
        self._wheels.shares = faults.wheel_shares
        self._wheels.stalls_ahead = faults.blocked_ahead
        self._battery.has_failed = faults.battery_empty

    @property
    def is_dead(self) -> bool:
        """Whether it is off: it does nothing and answers nothing. Thread: any."""
        return self._faults.dead

    @property
    def turret_yaw_rad(self) -> float:
        """Its turret's angle, counter-clockwise from straight ahead, unwrapped; 0 without a turret."""
        return self.turret.yaw_rad if self.turret else 0.0

    def place(self, queries: QuerySpace, pose: Pose2D) -> None:
        """Put it into the world, standing."""
        self.leave()
        self._queries = queries
        self._pose = pose

    def start(self, motion: WheelMotion) -> None:
        """Release the brakes and begin a motion.

        Raises:
            UnavailableError: it has no place in the world, its battery is empty, or it is dead.
        """
        self.leave()
        if self._pose is None:
            raise self._no_place()
        if self.is_dead:
            raise UnavailableError(f"robot {self.name!r} is dead")
        if self.battery.is_empty:
            raise UnavailableError(f"battery is empty: robot {self.name!r} cannot drive")
        if self._motion is None:
            self._last_pose = self._pose_before_last = self._pose
            self.report_odometry(self._now_s())
        if not (isinstance(self._motion, VelocityDrive) and isinstance(motion, VelocityDrive)):
            self._wheels.start(motion)
        self._motion, self.slipped_m = motion, 0.0

    def stop(self) -> None:
        """Put the brakes on: it stands at once."""
        self.leave()
        self._motion = None
        self._command_m = self._gone = self._wanted = (0.0, 0.0)

    def predict(self) -> None:
        """Turn its wheels for one tick, and compute the pose after it if nothing is in its way."""
        self.leave()
        if self._motion is None or self._pose is None:
            return
        self._command_m = self._motion.step()
        ahead_m, turn_rad = self._wanted = self._wheels.travel(*self._command_m)
        if self._odometer is not None:
            self._odometer.follow(self._wheels.counted_m, self._calibration)
        self.next_pose = moved(self._pose, ahead_m, turn_rad)

    def drive_on(self, tick: int, ticks: int) -> None:
        """Drive freely for some ticks after tick number `tick`, or until the motion is done."""
        odometer = self._odometer if self.localizer is not None else None
        for after in range(tick + 1, tick + ticks + 1):
            self.predict()
            self.arrive(self.next_pose)
            if odometer is not None and after % self.report_ticks == 0:
                self._reports.append((*odometer.pose, after * self.tick_s))
            if self.is_done(after * self.tick_s):
                break
        if len(self._reports) >= _MOST_REPORTS:
            self.hand_over_reports()

    def report_odometry(self, now_s: float) -> None:
        """Note the pose by odometry for the pose estimate."""
        self._update()
        if self._odometer is not None:
            self.report(self._odometer.pose, now_s)

    @override
    def report(self, odometry: Pose2D, now_s: float) -> None:
        if self.localizer is not None:
            self._reports.append((*odometry, now_s))
            if len(self._reports) >= _MOST_REPORTS:
                self.hand_over_reports()

    def hand_over_reports(self) -> None:
        """Tell the pose estimate the noted odometry: before it is read, set, or follows another driver."""
        reports, self._reports = self._reports, []
        if self.localizer is not None:
            self.localizer.odometry_path(reports)

    def is_done(self, now_s: float) -> bool:
        """Return whether its motion is over, or its battery empty, at the world's time `now_s`."""
        if self._motion is None or self._motion.is_over or self.slipped_m > self._motion.most_slip_m:
            return True
        return self._battery.is_empty_after(now_s, self._wheels.turned_m)

    def arrive(self, pose: Pose2D) -> None:
        """Set its pose at the end of a tick."""
        if pose is self.next_pose:
            self._gone = self._wanted
        else:
            x_m, y_m, yaw_rad = self.pose
            self._gone = math.hypot(pose[0] - x_m, pose[1] - y_m), pose[2] - yaw_rad
            arm_m, x_m, y_m, yaw_rad = self.make.track_m / 2, *self.next_pose
            self.slipped_m += math.hypot(pose[0] - x_m, pose[1] - y_m) + abs(pose[2] - yaw_rad) * arm_m
        self._pose_before_last, self._last_pose, self._pose = self._last_pose, self._pose or pose, pose

    @override
    def join(self, free: FreeRobots[Any], ticks: int) -> FreeState[float] | None:
        regular = self._motion.regular() if self._motion is not None else None
        if regular is None or regular.ticks < ticks or self._pose is None:
            return None
        if self._battery.has_failed or self._wheels.stalls_ahead:
            return None
        wheels = self._wheels.state()
        odometer = (self._odometer or WheelOdometer(self.make.track_m, (0.0, 0.0))).state(self._calibration)
        self.free = free
        poses = *self._pose, *self._last_pose, *self._pose_before_last
        travel = *self._command_m, *self._wanted, *wheels, *odometer, *self._battery.limits
        limit_m = self.make.max_speed_m_s * self.tick_s
        return FreeState._make((*poses, *travel, limit_m, *regular, *odometer[0:3], 0.0))

    @override
    def leave(self) -> None:
        free, self.free = self.free, None
        if free is not None:
            free.remove(self)
            self.report_odometry(self._now_s())

    def _update(self) -> None:
        """Copy its state from the array, if one has it."""
        if self.free is not None:
            self.free.update(self)

    @override
    def adopt(self, state: FreeState[float], ticks: int) -> None:
        self._pose = self.next_pose = state[0:3]
        self._last_pose, self._pose_before_last = state[3:6], state[6:9]
        self._command_m = state[9:11]
        self._wanted = self._gone = state[11:13]
        self._wheels.adopt(*state[13:16])
        if self._odometer is not None:
            self._odometer.adopt(*state[24:29])
        if self._motion is not None:
            self._motion.skip(ticks, state.travelled_m)

    def require_working(self, resource: str) -> None:
        """Raise ResourceFaultError if an injected fault lets a resource fail. Thread: any."""
        if resource in self._faults.failing:
            raise ResourceFaultError(f"injected fault: {resource} fails")

    def actuate(self, method: Callable[..., Any], actuator: str, *args: Any) -> Any:
        """Call a method of an actuator. If the robot dies during the activity, its result is lost. Thread: any."""
        self.require_working(actuator)
        begun = method(*args)
        return self._run_while_alive(begun, actuator) if isinstance(begun, types.GeneratorType) else begun

    def _run_while_alive(self, activity: Activity, actuator: str) -> Activity:
        try:
            result = yield from activity
        except UnavailableError:
            self.require_working(actuator)
            if not self.is_dead:
                raise
            result = None
        self.require_working(actuator)
        if not self.is_dead:
            return result
        while self.is_dead:
            yield _REVIVAL_POLL_S
        raise UnavailableError(f"robot {self.name!r} was dead meanwhile")

    def _no_place(self) -> UnavailableError:
        return UnavailableError(f"the simulated world has no free place for robot {self.name!r}")
