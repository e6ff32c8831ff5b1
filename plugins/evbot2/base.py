"""The base of an EvBot: the firmware carries the motions out, this asks for them and watches them end."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eal_actors.plugin import (
    Activity,
    ArgumentError,
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
)

from .messages import Channel, State, Verb, is_newer
from .odometry import Odometer
from .talk import LOOK_S, Talk
from .wheels import STALL_S

_DISTANCE: Final = ValueInfo(DataType.DOUBLE, "m", 0, 100)
_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_TRACK_FACTOR: Final = ValueInfo(DataType.DOUBLE, None, 0.5, 2, description="a factor; 1 is nominal")
_WHEEL_RATIO: Final = ValueInfo(DataType.DOUBLE, None, 0.9, 1.1, description="a ratio; 1 is nominal")
_ROUNDING: Final = 1e-9
_UM: Final = 1e6


@dataclass(frozen=True, slots=True)
class Make:
    """What a make of EvBot is known to be, before it is asked.

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


class EvBotBase(Resource):
    """Drives the robot; a make's own class adds the ranges of its speeds.

    Args:
        talk: the talk with the base; this resource polls it.
        odometer: knows the wheels' calibration.
        make: what the base is.
    """

    types = ResourceType.ACTUATOR
    value = ValueInfo(
        DataType.DOUBLE, shape=(2,), description="a twist: speed in m/s, turn rate in rad/s, to the left if positive"
    )

    def __init__(self, talk: Talk, odometer: Odometer, make: Make) -> None:
        self._talk = talk
        self._odometer = odometer
        self._make = make
        self._speed_m_s = make.speed_m_s
        self._turn_rate_deg_s = make.turn_rate_deg_s
        self._step_m = 0.5
        self._twist_timeout_s = 0.5

    def not_ready(self) -> str | None:
        """Return why the base cannot be driven at present."""
        return self._talk.why_not_ready()

    def background(self) -> Activity:
        """Talk to the base for all resources."""
        return self._talk.poll()

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves, 2 while something holds it up."""
        wheels = self._talk.latest().wheels
        if wheels.state != State.MOVING:
            return 0
        return 2 if wheels.strain else 1

    def halt(self) -> None:
        """Stop at once."""
        self._talk.stop(Channel.WHEELS)

    def set_value(self, data: EALData) -> Activity:
        """Drive at a twist until a newer command, or until the time-out passes without one.

        Raises:
            ArgumentError: the make does not reach it, or it is no number.
        """
        speed_m_s, turn_rate_rad_s = (float(number) for number in data.value)
        make = self._make
        self._check_reach("speed", speed_m_s, make.max_speed_m_s, "m/s")
        self._check_reach("turn rate", turn_rate_rad_s, math.radians(make.max_turn_rate_deg_s), "rad/s")
        left_m_s, right_m_s = self._odometer.calibration.counted(speed_m_s, turn_rate_rad_s * make.track_m / 2)
        excess = max(1.0, abs(left_m_s) / make.max_speed_m_s, abs(right_m_s) / make.max_speed_m_s)
        left_um_s, right_um_s = (math.trunc(wheel_m_s / excess * _UM) for wheel_m_s in (left_m_s, right_m_s))
        return self._hold(left_um_s, right_um_s, round(self._twist_timeout_s * 1000))

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

    @config("speed_m_s", ValueInfo(DataType.DOUBLE, "m/s", 0.01))
    def speed_m_s(self) -> float:
        """Speed of driving straight."""
        return self._speed_m_s

    @config_setter("speed_m_s")
    def set_speed_m_s(self, speed_m_s: float) -> None:
        """Set the speed of later commands."""
        self._speed_m_s = float(speed_m_s)

    @config("turn_rate_deg_s", ValueInfo(DataType.DOUBLE, "deg/s", 1))
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
        return self._make.track_m

    @config("track_factor", _TRACK_FACTOR)
    def track_factor(self) -> float:
        """Effective over nominal distance of the wheels: E_b of the square test."""
        return self._odometer.calibration.track_factor

    @config_setter("track_factor")
    def set_track_factor(self, track_factor: float) -> None:
        """Set what later commands, twists and the odometry know of the distance of the wheels."""
        self._calibrate(track_factor=float(track_factor))

    @config("wheel_ratio", _WHEEL_RATIO)
    def wheel_ratio(self) -> float:
        """Diameter of the right wheel over the left one's: E_d of the square test."""
        return self._odometer.calibration.wheel_ratio

    @config_setter("wheel_ratio")
    def set_wheel_ratio(self, wheel_ratio: float) -> None:
        """Set what later commands, twists and the odometry know of the wheels' diameters."""
        self._calibrate(wheel_ratio=float(wheel_ratio))

    def _calibrate(self, **change: float) -> None:
        known = self._odometer.calibration
        self._odometer.calibration = WheelCalibration.model_validate({**known.model_dump(), **change})

    def _check_reach(self, what: str, value: float, most: float, unit: str) -> None:
        if not abs(value) <= most + _ROUNDING:
            raise ArgumentError(
                f"the twist's {what} must be {-most:.4g}..{most:.4g} {unit}, "
                f"which the {self._make.name} reaches, not {value:g}"
            )

    # Motions.

    def _drive(self, distance_m: float) -> Activity:
        return self._move(distance_m, 0.0, self._speed_m_s)

    def _turn(self, degrees: float) -> Activity:
        arm_m = self._make.track_m / 2
        return self._move(0.0, math.radians(degrees) * arm_m, math.radians(self._turn_rate_deg_s) * arm_m)

    def _move(self, ahead_m: float, arc_m: float, speed_m_s: float) -> Activity:
        """Have the firmware carry out a motion from rest to rest, and watch it."""
        travels_m = self._odometer.calibration.counted(ahead_m, arc_m)
        left_um, right_um = (round(travel_m * _UM) for travel_m in travels_m)
        most_um_s = math.floor(self._make.max_speed_m_s * _UM + _ROUNDING)
        return self._run(left_um, right_um, min(round(speed_m_s * _UM), most_um_s))

    def _run(self, left_um: int, right_um: int, speed_um_s: int) -> Activity:
        is_done = False
        try:
            yield from watched(self._talk, Verb.MOVE, (left_um, right_um, speed_um_s), self._outcome)
            is_done = True
            return 1
        finally:
            if not is_done:
                self.halt()

    def _hold(self, left_um_s: int, right_um_s: int, hold_ms: int) -> Activity:
        """Hold a twist. Closing it lets the wheels turn on: a newer twist takes over without a stop, a halt stops."""
        yield from watched(self._talk, Verb.VEL, (left_um_s, right_um_s, hold_ms), self._outcome)

    def _outcome(self) -> tuple[int, State]:
        wheels = self._talk.latest().wheels
        return wheels.order, State(wheels.state)


def watched(talk: Talk, verb: Verb, numbers: tuple[int, ...], outcome: Callable[[], tuple[int, State]]) -> Activity:
    """Give an order for a motion, and wait until it is done.

    Args:
        talk: the talk with the base.
        verb: of the order.
        numbers: of the order.
        outcome: returns the tag of the motion that the channel has begun last, and what became of it.

    Raises:
        NotReadyError: the base is away.
        ResourceFaultError: it refuses the motion, or what it drives is stuck.
        UnavailableError: it has stopped by itself, or does not acknowledge.
    """
    tag = yield from talk.order(verb, *numbers)
    while True:
        order, state = outcome()
        if order == tag and state is not State.MOVING:
            break
        if is_newer(order, tag):
            raise UnavailableError(f"another order took the place of {verb.name}")
        yield max(talk.next_look_s(), LOOK_S)
    if state is State.STALLED:
        raise ResourceFaultError(f"halted: it was driven, and its encoders counted nothing in {STALL_S:g} s")
    if state is State.SILENT:
        raise UnavailableError(f"the base heard nothing for {talk.watchdog_s:g} s, and has stopped by itself")
    if state is not State.DONE:
        raise UnavailableError("the base was stopped")
