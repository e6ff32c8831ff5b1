"""The Roomba's base: it drives, and its background activity polls."""

from __future__ import annotations

import math
from typing import Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    DifferentialBase,
    Drivetrain,
    ResourceFaultError,
    UnavailableError,
    WheelCalibration,
    get_logger,
)

from .driver import RoombaDriver
from .groups import Contacts
from .motion import MAX_SPEED_MM_S, MAX_TURN_RATE_DEG_S, MotionProgress, WheelMotion

_MOST_DOUBT_M: Final = 0.03  # of the travel, in one straight drive
_MOST_DOUBT_IN_A_TURN_M: Final = 0.01
_REST_S: Final = 1.0  # time limit to come to rest
_STEP_S: Final = 0.05  # interval of speed updates, also with fewer readings
_AT_END_M: Final = 0.0002  # below the resolution of the encoders
_NEAR_COUNTS: Final = 1.5  # tolerance of the end of a motion, in encoder counts
_OVERSHOT_M: Final = 0.005  # a motion that overshoots by this drives back
_ATTEMPTS: Final = 3  # corrections of a motion, because its progress between readings is estimated
_RESEND_S: Final = 0.3  # without a count, the wheel command is sent again: it may have been lost
_STALL_S: Final = 2.0  # without a count from driven wheels; the slowest turn counts twice a second


class RoombaBase(DifferentialBase):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked."""

    def __init__(self, roomba: RoombaDriver) -> None:
        super().__init__(
            Drivetrain("roomba", roomba.wheelbase_m, 0.3, MAX_SPEED_MM_S / 1000, 90.0, MAX_TURN_RATE_DEG_S)
        )
        self._roomba = roomba
        self._in_motion = False
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
        return self._run(WheelMotion.straight(distance_m, speed_m_s, self.calibration))

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        return self._run(WheelMotion.turn(angle_rad, turn_rate_rad_s, self.drivetrain.track_m, self.calibration))

    def _run(self, motion: WheelMotion) -> Activity:
        """Carry out a motion, from rest to rest."""
        if self._twist_until_s is not None:
            self.halt()
        self._in_motion = True
        try:
            yield from self._come_to_rest()
            start_m = motion.counted_m(self._roomba.latest())
            for _ in range(_ATTEMPTS):
                yield from self._go(motion, start_m)
                self._roomba.stop()
                yield from self._come_to_rest()
                left_m = motion.left_m(self._roomba.latest(), start_m)
                if -_OVERSHOT_M < left_m < _NEAR_COUNTS * self._roomba.count_m:
                    break
                if left_m < 0:  # a command to slow down was lost
                    motion = motion.back(-left_m)
                    start_m = motion.counted_m(self._roomba.latest())
            return 1
        finally:
            self._in_motion = False
            self._roomba.stop()

    def _come_to_rest(self) -> Activity:
        """Wait until a reading requested from now on shows both wheels at rest."""
        begun_s = self._roomba.clock.now()
        while self._roomba.clock.now() - begun_s < _REST_S:
            reading = self._roomba.latest()
            if reading.stamp_s >= begun_s and reading.stands:
                return
            yield self._roomba.next_look_s()

    def _go(self, motion: WheelMotion, start_m: float) -> Activity:
        """Drive until the encoders have counted the motion's length; slow down before its end."""
        progress = MotionProgress(motion, self._roomba.latest(), start_m, self._roomba.clock.now())
        resent_s, doubted_m = 0.0, self._roomba.travel_doubt_m
        most_doubt_m = _MOST_DOUBT_M if motion.ahead else _MOST_DOUBT_IN_A_TURN_M
        while True:
            reading = self._roomba.latest()
            self._check_motion(forward=motion.goes_forward)
            left_m = progress.update(reading, self._roomba.clock.now())
            if (doubt_m := self._roomba.travel_doubt_m - doubted_m) > most_doubt_m:
                raise ResourceFaultError(
                    "halted: readings were lost on their way, and with them what the wheels travelled, which may be "
                    f"wrong by {doubt_m:.3f} m"
                )
            if progress.stalled_s > _STALL_S:
                self._roomba.doubt()
                raise ResourceFaultError(
                    f"driven at {progress.velocity_mm_s} mm/s, the wheels counted nothing in {_STALL_S:g} s"
                )
            self.progress(1 - left_m / motion.length_m if motion.length_m else None)
            if left_m <= _AT_END_M:
                return
            velocity_mm_s = motion.velocity_mm_s(left_m)
            if velocity_mm_s != progress.velocity_mm_s or progress.stalled_s > resent_s + _RESEND_S:
                resent_s = progress.stalled_s
                yield from self._roomba.drive(self._roomba.wheels(*motion.wheels_mm_s(velocity_mm_s)))
                progress.velocity_mm_s = velocity_mm_s
            yield min(left_m / velocity_mm_s * 1000, self._roomba.next_look_s(), _STEP_S)

    def _check_motion(self, *, forward: bool) -> None:
        """Raise ResourceFaultError if the robot must stop, or has ended the motion by itself."""
        _check_ground(self._roomba.latest().contacts, forward=forward)
        if (why := self._roomba.interruption) is not None:
            raise ResourceFaultError(f"halted: {why}")

    # Twists.

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        drive = self._roomba.twist(speed_m_s, turn_rate_rad_s)
        forward = drive.goes_forward
        _check_ground(self._roomba.latest().contacts, forward=forward)
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
        if self._roomba.is_due(self._twist_until_s):
            self.halt()
            return
        try:
            self._check_motion(forward=self._twist_forward)
        except (ResourceFaultError, UnavailableError) as error:
            self.halt()
            get_logger().warning("a twist is halted", reason=error.message)


def _check_ground(contacts: Contacts, *, forward: bool) -> None:
    """Raise ResourceFaultError if a wheel has dropped, or if a forward motion meets a cliff."""
    drops = {"left wheel": contacts.drop_left, "right wheel": contacts.drop_right, "caster": contacts.drop_caster}
    cliffs = {
        "left": contacts.cliff_left,
        "front left": contacts.cliff_front_left,
        "front right": contacts.cliff_front_right,
        "right": contacts.cliff_right,
    }
    if contacts.any_drop:
        raise ResourceFaultError(f"halted: wheel drop ({', '.join(name for name, is_so in drops.items() if is_so)})")
    if forward and contacts.any_cliff:
        raise ResourceFaultError(f"halted: cliff ({', '.join(name for name, is_so in cliffs.items() if is_so)})")
