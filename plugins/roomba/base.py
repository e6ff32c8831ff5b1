"""The Roomba's base: it drives, and its background activity polls."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    DifferentialBase,
    Drivetrain,
    PluginContext,
    ResourceFaultError,
    SlipWatch,
    UnavailableError,
    WheelCalibration,
    get_logger,
)

from .driver import RoombaDriver
from .motion import BRAKE_M_S2, MAX_SPEED_MM_S, MAX_TURN_RATE_DEG_S, MotionGoal, MotionProgress, TimedMotion
from .predicted_wheels import Travel
from .senses import ground_fault

_MOST_OFF_M: Final = 0.04  # from the goal of a motion, the doubt about the travel included
_MOST_OFF_RAD: Final = math.radians(3.5)
_MOST_OFF_CHECKED_RAD: Final = math.radians(3.9)  # on a line with checksums, whose doubt is nearer to the truth
_HEADING_RAD: Final = math.radians(1.5)  # a straight drive turns back if it is off by more
_ASTRAY_RAD: Final = math.radians(4)  # a straight drive stops to turn back
_TURN_BACK_RAD_S: Final = math.radians(30)
_BLIND_M: Final = 0.06  # travelled at most before a reading shows it
_LOOK_S: Final = 0.02
_REST_S: Final = 1.0  # time limit to come to rest
_STEP_S: Final = 0.05  # interval of speed updates, also with fewer readings
_AT_END_M: Final = 0.0002  # below the resolution of the encoders
_NEAR_COUNTS: Final = 1.5  # tolerance of the end of a motion, in encoder counts
_OVERSHOT_M: Final = 0.003  # a motion that overshoots by this drives back
_ATTEMPTS: Final = 4  # corrections of a motion, because its progress between readings is estimated
_HELD_UP_S: Final = 0.25  # the poller is late by this if the program was held up
_STALL_S: Final = 2.0  # without a count from driven wheels; the slowest turn counts twice a second


class RoombaBase(DifferentialBase):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked."""

    def __init__(self, roomba: RoombaDriver, context: PluginContext | None = None) -> None:
        limits = 0.3, MAX_SPEED_MM_S / 1000, 90.0, MAX_TURN_RATE_DEG_S, BRAKE_M_S2, 0.17
        super().__init__(Drivetrain("roomba", roomba.wheelbase_m, *limits), context)
        self._roomba = roomba
        self._most_off_rad = _MOST_OFF_CHECKED_RAD if roomba.has_checksums else _MOST_OFF_RAD
        self._in_motion = False
        self._held_up_s = 0.0  # the longest time in a motion
        self._twist_until_s: float | None = None
        self._twist_forward = False

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    def close(self) -> None:
        """Stop, and release the Roomba into passive mode."""
        self._roomba.release()

    def background(self) -> Activity:
        """Poll for all resources, and end a twist when its time is over."""
        poll, poll_at_s, clock = self._roomba.poll(), -math.inf, self._roomba.clock
        while True:
            if self._roomba.is_due(poll_at_s):
                poll_at_s = clock.now() + next(poll)
            self._watch_twist()
            until_s = poll_at_s if self._twist_until_s is None else min(poll_at_s, self._twist_until_s)
            yield max(0.0, until_s - clock.now())
            if (late_s := clock.now() - until_s) > _HELD_UP_S:
                self._held_up_s = max(late_s, self._held_up_s)

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves, 2 while it is blocked."""
        if not self._in_motion and self._twist_until_s is None:
            return 0
        contacts = self._roomba.latest().contacts
        strained = contacts.overcurrent_drive_left or contacts.overcurrent_drive_right
        return 2 if strained or contacts.bump_left or contacts.bump_right else 1

    def halt(self) -> None:
        """Stop at once."""
        self._twist_until_s = None
        self._roomba.stop()

    @override
    def clearance_m(self, *, forward: bool) -> float:
        contacts = self._roomba.latest_in_motion().contacts
        return 0.0 if forward and (contacts.bump_left or contacts.bump_right) else math.inf

    @override
    def is_held(self) -> bool:
        contacts = (
            self._roomba.latest_in_motion().contacts
        )  # not the bumper: it stays pressed while the robot turns away
        return contacts.overcurrent_drive_left or contacts.overcurrent_drive_right

    @property
    @override
    def calibration(self) -> WheelCalibration:
        return self._roomba.calibration

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        self._roomba.calibration = calibration

    # Motions.

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        return self._run(TimedMotion.straight(distance_m, speed_m_s, self.calibration), distance_m, 0.0)

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        return self._run(self._turning(angle_rad, turn_rate_rad_s), 0.0, angle_rad)

    def _turning(self, angle_rad: float, turn_rate_rad_s: float) -> TimedMotion:
        return TimedMotion.turn(angle_rad, turn_rate_rad_s, self.drivetrain.track_m, self.calibration)

    def _run(self, motion: TimedMotion, distance_m: float, angle_rad: float) -> Activity:
        """Carry out a motion, from rest to rest; return 1 where it ends at its goal."""
        if self._twist_until_s is not None:
            self.halt()
        self._in_motion, self._held_up_s = True, 0.0
        try:
            yield from self._come_to_rest()
            goal = MotionGoal.of(self._roomba.latest_in_motion().pose, distance_m, angle_rad)
            doubt = self._roomba.travel_doubt
            yield from self._travel(motion, goal)
            self._check_goal(goal, *self._doubt(doubt, distance_m))
            return 1
        except ResourceFaultError as error:
            if self._held_up_s:
                raise ResourceFaultError(
                    f"{error.message}; this program was held up for {self._held_up_s:.1f} s during the motion"
                ) from error
            raise
        finally:
            self._in_motion = False

    def _travel(self, motion: TimedMotion, goal: MotionGoal) -> Activity:
        """Travel a motion's length; what damaged commands added is taken back."""
        doubt, start_m = self._roomba.travel_doubt, motion.counted_m(self._roomba.latest_in_motion())
        for _ in range(_ATTEMPTS):
            try:
                yield from self._go(motion, start_m, goal, doubt)
            finally:
                self._roomba.stop()
            yield from self._come_to_rest()
            if motion.ahead:
                yield from self._turn_back(goal)
            left_m = motion.left_m(self._roomba.latest_in_motion(), start_m)
            if -_OVERSHOT_M < left_m < _NEAR_COUNTS * self._roomba.count_m:
                break
            if left_m < 0:  # a command to slow down was lost
                motion = motion.back(-left_m)
                start_m = motion.counted_m(self._roomba.latest_in_motion())

    def _turn_back(self, goal: MotionGoal) -> Activity:
        """Turn back to the heading of a straight drive, if it was lost."""
        _, off_rad = goal.off(self._roomba.latest_in_motion().pose)
        if abs(off_rad) > _HEADING_RAD:
            yield from self._travel(self._turning(off_rad, _TURN_BACK_RAD_S), goal)

    def _check_goal(self, goal: MotionGoal, doubt_m: float, doubt_rad: float) -> None:
        """Raise ResourceFaultError if the robot may not stand at its goal."""
        off_m, off_rad = goal.off(self._roomba.latest_in_motion().pose)
        if off_m + doubt_m > _MOST_OFF_M or abs(off_rad) + doubt_rad > self._most_off_rad:
            raise ResourceFaultError(
                f"it stands {off_m:.3f} m and {math.degrees(abs(off_rad)):.1f} degrees from the end of the motion, "
                f"which may be wrong by {doubt_m:.3f} m and {math.degrees(doubt_rad):.1f} degrees: "
                "commands or readings were lost, damaged or delayed on their way"
            )

    def _come_to_rest(self) -> Activity:
        """Wait until a reading requested from now on shows both wheels at rest.

        Raises:
            ResourceFaultError: they turn on.
        """
        begun_s, waited_s = self._roomba.clock.now(), 0.0  # a program that is held up has not looked meanwhile
        while waited_s < _REST_S + 2 * self._roomba.lag_s:
            reading = self._roomba.latest_in_motion()
            if reading.stamp_s >= begun_s and reading.stands:
                return
            look_s = self._roomba.next_look_s()
            yield look_s
            waited_s += look_s
        raise ResourceFaultError("it was stopped, and its wheels still turn; the stop is repeated")

    def _go(self, motion: TimedMotion, start_m: float, goal: MotionGoal, doubt: Travel) -> Activity:
        """Drive until the encoders have counted the motion's length; slow down before its end."""
        begun_s, changed_s = self._roomba.clock.now(), -math.inf
        progress, watch = MotionProgress(motion, start_m, begun_s), SlipWatch(is_turn=not motion.ahead)
        while True:
            reading, now_s, lag_s = self._roomba.latest_in_motion(), self._roomba.clock.now(), self._roomba.lag_s
            self._check_motion(forward=motion.goes_forward)
            self._check_doubt(doubt)
            watch.update(reading.stamp_s, motion.counted_m(reading), is_held=self.is_held())
            left_m = progress.update(reading, now_s)
            if progress.stalled_s > _STALL_S + lag_s:
                self._roomba.doubt()
                raise ResourceFaultError(
                    f"driven at {progress.velocity_mm_s} mm/s, the wheels counted nothing in {_STALL_S:g} s"
                )
            self.progress(1 - left_m / motion.length_m if motion.length_m else None)
            if left_m <= _AT_END_M or (motion.ahead and abs(goal.off(reading.pose)[1]) > _ASTRAY_RAD):
                return
            most_m_s = min(_BLIND_M / max(lag_s, _LOOK_S), self._roomba.acceleration_m_s2 * (now_s - begun_s + _STEP_S))
            velocity_mm_s = motion.slower(most_m_s).velocity_mm_s(left_m)
            if velocity_mm_s != progress.velocity_mm_s and now_s >= changed_s + _STEP_S / 2:
                changed_s = now_s
                yield from self._roomba.drive(self._roomba.wheels(*motion.wheels_mm_s(velocity_mm_s)))
                progress.command(velocity_mm_s, self._roomba.clock.now())
            yield min(left_m / max(velocity_mm_s, progress.velocity_mm_s) * 1000, self._roomba.next_look_s(), _STEP_S)

    def _doubt(self, before: Travel, distance_m: float) -> tuple[float, float]:
        """Return how far the position in m and the heading in rad may be wrong after a drive."""
        doubt = self._roomba.travel_doubt.plus(before, -1.0)
        doubt_rad = doubt.arc_m / (self.drivetrain.track_m / 2)
        return doubt.ahead_m + abs(distance_m) * doubt_rad, doubt_rad

    def _check_doubt(self, before: Travel) -> None:
        """Raise ResourceFaultError if too much of the travel is not known."""
        doubt_m, doubt_rad = self._doubt(before, 0.0)
        if doubt_m > _MOST_OFF_M or doubt_rad > self._most_off_rad:
            raise ResourceFaultError(
                "halted: readings were lost or damaged on their way, and with them what the wheels travelled, which "
                f"may be wrong by {doubt_m:.3f} m and {math.degrees(doubt_rad):.1f} degrees"
            )

    def _check_motion(self, *, forward: bool) -> None:
        """Raise ResourceFaultError if the robot must stop, or has ended the motion by itself."""
        self._check_ground(forward=forward)
        if (why := self._roomba.interruption) is not None:
            raise ResourceFaultError(f"halted: {why}")

    def _check_ground(self, *, forward: bool) -> None:
        contacts = self._roomba.latest_in_motion().contacts
        if (fault := ground_fault(contacts.drops, contacts.cliffs, forward=forward)) is not None:
            raise fault

    # Twists.

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        drive = self._roomba.twist(speed_m_s, turn_rate_rad_s)
        forward = drive.goes_forward
        self._check_ground(forward=forward)
        yield from self._roomba.drive(drive)
        self._twist_until_s = until_s = self._roomba.clock.now() + timeout_s
        self._twist_forward = forward
        while not self._roomba.is_due(until_s):
            yield min(self._roomba.next_look_s(), until_s - self._roomba.clock.now())
            self._check_motion(forward=forward)
        self.halt()

    def _watch_twist(self) -> None:
        """End a twist at its timeout, a cliff or a drop; its caller may be gone."""
        if self._twist_until_s is None:
            return
        if not self._roomba.is_due(self._twist_until_s):
            try:
                self._check_motion(forward=self._twist_forward)
            except (ResourceFaultError, UnavailableError) as error:
                get_logger().warning("a twist is halted", reason=error.message)
            else:
                return
        with suppress(UnavailableError):  # over a broken link the driver stops it again when the link is back
            self.halt()
