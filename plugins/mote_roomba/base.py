"""The Roomba's base: it drives, and its background activity polls."""

from __future__ import annotations

import math
from typing import Final

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    Resource,
    ResourceFaultError,
    ResourceType,
    UnavailableError,
    ValueInfo,
    WheelCalibration,
    command,
    config,
    config_setter,
    get_logger,
)

from .driver import RoombaDriver
from .groups import Contacts
from .motion import MAX_SPEED_MM_S, MAX_TURN_RATE_DEG_S, Motion, Progress
from .reading import Drive

_DISTANCE: Final = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_SPEED: Final = ValueInfo(DataType.DOUBLE, "m/s", 0.01, MAX_SPEED_MM_S / 1000)
_TURN_RATE: Final = ValueInfo(DataType.DOUBLE, "deg/s", 1, MAX_TURN_RATE_DEG_S)
_TRACK_FACTOR: Final = ValueInfo(DataType.DOUBLE, None, 0.5, 2, description="a factor; 1 is nominal")
_WHEEL_RATIO: Final = ValueInfo(DataType.DOUBLE, None, 0.9, 1.1, description="a ratio; 1 is nominal")
_MOST_DOUBT_M: Final = 0.03  # of the travel, in one straight drive
_MOST_DOUBT_IN_A_TURN_M: Final = 0.01
_REST_S: Final = 1.0  # the longest that it may take to come to rest
_STEP_S: Final = 0.05  # between two looks at the speed, also where readings are rarer
_AT_END_M: Final = 0.0002  # below what the encoders count
_NEAR_COUNTS: Final = 1.5  # of the encoders, within which a motion is at its end
_OVERSHOT_M: Final = 0.005  # so far beyond its length a motion goes back
_ATTEMPTS: Final = 3  # at a motion's length, as between readings its progress is guessed
_TELL_AGAIN_S: Final = 0.3  # without a count, after which the command to the wheels may have been lost on its way
_STALL_S: Final = 2.0  # without a count from driven wheels; the slowest turn counts twice a second


class Base(Resource):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked."""

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    def __init__(self, roomba: RoombaDriver) -> None:
        self._roomba = roomba
        self._speed_m_s = 0.3
        self._turn_rate_deg_s = 90.0
        self._step_m = 0.5
        self._twist_timeout_s = 0.5
        self._in_motion = False
        self._twist_until_s: float | None = None
        self._twist_forward = False

    def not_ready(self) -> str | None:
        """Return why the Roomba cannot be used at present."""
        return self._roomba.not_ready()

    def close(self) -> None:
        """Stop, and leave the Roomba to itself in passive mode."""
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
        """Return 0 while it stands, 1 while it moves, 2 while something holds it up."""
        if not self._in_motion and self._twist_until_s is None:
            return 0
        contacts = self._roomba.latest().contacts
        strained = contacts.overcurrent_drive_left or contacts.overcurrent_drive_right
        return 2 if strained or contacts.bump_left or contacts.bump_right else 1

    def halt(self) -> None:
        """Stop at once."""
        self._twist_until_s = None
        self._roomba.stop()

    def set_value(self, data: EALData) -> Activity:
        """Drive at a twist until a newer command, or until the time-out passes without one.

        Raises:
            ArgumentError: the Roomba does not reach it, or it is no number.
        """
        speed_m_s, turn_rate_rad_s = (float(number) for number in data.value)
        return self._hold(self._roomba.twist(speed_m_s, turn_rate_rad_s))

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
        return self._roomba.wheelbase_m

    @config("track_factor", _TRACK_FACTOR)
    def track_factor(self) -> float:
        """Effective over nominal distance of the wheels: E_b of the square test."""
        return self._roomba.calibration.track_factor

    @config_setter("track_factor")
    def set_track_factor(self, track_factor: float) -> None:
        """Set what later commands, twists and the odometry know of the distance of the wheels."""
        self._calibrate(track_factor=float(track_factor))

    @config("wheel_ratio", _WHEEL_RATIO)
    def wheel_ratio(self) -> float:
        """Diameter of the right wheel over the left one's: E_d of the square test."""
        return self._roomba.calibration.wheel_ratio

    @config_setter("wheel_ratio")
    def set_wheel_ratio(self, wheel_ratio: float) -> None:
        """Set what later commands, twists and the odometry know of the wheels' diameters."""
        self._calibrate(wheel_ratio=float(wheel_ratio))

    def _calibrate(self, **change: float) -> None:
        known = self._roomba.calibration
        self._roomba.calibration = WheelCalibration.model_validate({**known.model_dump(), **change})

    # Motions.

    def _drive(self, distance_m: float) -> Activity:
        return self._run(Motion.straight(distance_m, self._speed_m_s, self._roomba.calibration))

    def _turn(self, degrees: float) -> Activity:
        roomba, rate_rad_s = self._roomba, math.radians(self._turn_rate_deg_s)
        return self._run(Motion.turn(math.radians(degrees), rate_rad_s, roomba.wheelbase_m, roomba.calibration))

    def _run(self, motion: Motion) -> Activity:
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
                if left_m < 0:  # a command to slow down was lost on its way
                    motion = motion.back(-left_m)
                    start_m = motion.counted_m(self._roomba.latest())
            return 1
        finally:
            self._in_motion = False
            self._roomba.stop()

    def _come_to_rest(self) -> Activity:
        """Wait until a reading that is asked for from now on sees both wheels stand."""
        begun_s = self._roomba.clock.now()
        while self._roomba.clock.now() - begun_s < _REST_S:
            reading = self._roomba.latest()
            if reading.stamp_s >= begun_s and reading.stands:
                return
            yield self._roomba.next_look_s()

    def _go(self, motion: Motion, start_m: float) -> Activity:
        """Drive until the encoders have counted the motion's length, slowing down towards its end."""
        progress = Progress(motion, self._roomba.latest(), start_m, self._roomba.clock.now())
        told_s, doubted_m = 0.0, self._roomba.travel_doubt_m
        most_doubt_m = _MOST_DOUBT_M if motion.ahead else _MOST_DOUBT_IN_A_TURN_M
        while True:
            reading = self._roomba.latest()
            self._require_way(forward=motion.goes_forward)
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
            if velocity_mm_s != progress.velocity_mm_s or progress.stalled_s > told_s + _TELL_AGAIN_S:
                told_s = progress.stalled_s
                yield from self._roomba.drive(self._roomba.wheels(*motion.wheels_mm_s(velocity_mm_s)))
                progress.velocity_mm_s = velocity_mm_s
            yield min(left_m / velocity_mm_s * 1000, self._roomba.next_look_s(), _STEP_S)

    def _require_way(self, *, forward: bool) -> None:
        """Raise ResourceFaultError if the robot must not go on, or has ended the motion by itself."""
        _require_ground(self._roomba.latest().contacts, forward=forward)
        if (why := self._roomba.interruption) is not None:
            raise ResourceFaultError(f"halted: {why}")

    # Twists.

    def _hold(self, drive: Drive) -> Activity:
        """Hold a twist. Closing it lets the wheels turn on: a newer twist takes over without a stop, a halt stops."""
        forward = drive.goes_forward
        _require_ground(self._roomba.latest().contacts, forward=forward)
        yield from self._roomba.drive(drive)
        self._twist_until_s = until_s = self._roomba.clock.now() + self._twist_timeout_s
        self._twist_forward = forward
        while not self._roomba.is_due(until_s):
            yield min(self._roomba.next_look_s(), until_s - self._roomba.clock.now())
            self._require_way(forward=forward)
        self.halt()

    def _watch_twist(self) -> None:
        """End a twist whose time is over, or under which the ground has gone, for it may have no caller any more."""
        if self._twist_until_s is None:
            return
        if self._roomba.is_due(self._twist_until_s):
            self.halt()
            return
        try:
            self._require_way(forward=self._twist_forward)
        except (ResourceFaultError, UnavailableError) as error:
            self.halt()
            get_logger().warning("a twist is halted", reason=error.message)


def _require_ground(contacts: Contacts, *, forward: bool) -> None:
    """Raise ResourceFaultError if a wheel has dropped, or if a cliff lies where the robot is to go."""
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
