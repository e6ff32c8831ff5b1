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
    command,
    config,
    config_setter,
    get_logger,
)

from .groups import Contacts
from .motion import MAX_TURN_RATE_DEG_S, Motion, Progress, twist_drive
from .protocol import MAX_SPEED_MM_S
from .roomba import Roomba

_DISTANCE: Final = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_SPEED: Final = ValueInfo(DataType.DOUBLE, "m/s", 0.01, MAX_SPEED_MM_S / 1000)
_TURN_RATE: Final = ValueInfo(DataType.DOUBLE, "deg/s", 1, MAX_TURN_RATE_DEG_S)
_REST_S: Final = 1.0  # the longest that it may take to come to rest
_STEP_S: Final = 0.05  # between two looks at the speed, also where readings are rarer
_AT_END_M: Final = 0.0002  # below what the encoders count
_NEAR_M: Final = 0.0015  # they count whole millimetres
_ATTEMPTS: Final = 3  # at a motion's length, as between readings its progress is guessed
_STALL_S: Final = 2.0  # without a count from driven wheels; the slowest turn counts twice a second


class Base(Resource):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked."""

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    def __init__(self, roomba: Roomba) -> None:
        self._roomba = roomba
        self._speed_m_s = 0.3
        self._turn_rate_deg_s = 90.0
        self._step_m = 0.5
        self._twist_timeout_s = 0.5
        self._in_motion = False
        self._twist_until_s: float | None = None
        self._twist_forward = False

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
        contacts = self._roomba.latest().sensors.contacts
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
        velocity_mm_s, radius_mm = twist_drive(speed_m_s, turn_rate_rad_s)
        return self._hold(velocity_mm_s, radius_mm, forward=speed_m_s > 0)

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

    # Motions.

    def _drive(self, distance_m: float) -> Activity:
        return self._run(Motion.straight(distance_m, self._speed_m_s))

    def _turn(self, degrees: float) -> Activity:
        return self._run(Motion.turn(math.radians(degrees), math.radians(self._turn_rate_deg_s)))

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
                if motion.left_m(self._roomba.latest(), start_m) < _NEAR_M:
                    break
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
        while True:
            reading = self._roomba.latest()
            _require_ground(reading.sensors.contacts, forward=motion.goes_forward)
            left_m = progress.update(reading, self._roomba.clock.now())
            if progress.stalled_s > _STALL_S:
                self._roomba.doubt()
                raise ResourceFaultError(
                    f"driven at {progress.velocity_mm_s} mm/s, the wheels counted nothing in {_STALL_S:g} s"
                )
            if left_m <= _AT_END_M:
                return
            velocity_mm_s = motion.velocity_mm_s(left_m)
            if velocity_mm_s != progress.velocity_mm_s:
                yield from self._roomba.drive(motion.velocity_sign * velocity_mm_s, motion.radius_mm)
                progress.velocity_mm_s = velocity_mm_s
            yield min(left_m / velocity_mm_s * 1000, self._roomba.next_look_s(), _STEP_S)

    # Twists.

    def _hold(self, velocity_mm_s: int, radius_mm: int, *, forward: bool) -> Activity:
        """Hold a twist. Closing it lets the wheels turn on: a newer twist takes over without a stop, a halt stops."""
        _require_ground(self._roomba.latest().sensors.contacts, forward=forward)
        yield from self._roomba.drive(velocity_mm_s, radius_mm)
        self._twist_until_s = until_s = self._roomba.clock.now() + self._twist_timeout_s
        self._twist_forward = forward
        while not self._roomba.is_due(until_s):
            yield min(self._roomba.next_look_s(), until_s - self._roomba.clock.now())
            _require_ground(self._roomba.latest().sensors.contacts, forward=forward)
        self.halt()

    def _watch_twist(self) -> None:
        """End a twist whose time is over, or under which the ground has gone, for it may have no caller any more."""
        if self._twist_until_s is None:
            return
        if self._roomba.is_due(self._twist_until_s):
            self.halt()
            return
        try:
            _require_ground(self._roomba.latest().sensors.contacts, forward=self._twist_forward)
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
