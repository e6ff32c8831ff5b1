"""The base of an EvBot: the firmware carries the motions out, this asks for them and watches them end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

from eal_actors.plugin import (
    Activity,
    DifferentialBase,
    Drivetrain,
    ResourceFaultError,
    UnavailableError,
    WheelCalibration,
)

from .messages import Channel, State, Verb, is_newer
from .odometry import Odometer
from .talk import LOOK_S, Talk
from .wheels import STALL_S

_ROUNDING: Final = 1e-9
_UM: Final = 1e6


class Base(DifferentialBase):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked.

    Args:
        talk: the talk with the base; this resource polls it.
        odometer: knows the wheels' calibration.
        drivetrain: what the base is.
    """

    def __init__(self, talk: Talk, odometer: Odometer, drivetrain: Drivetrain) -> None:
        super().__init__(drivetrain)
        self._talk = talk
        self._odometer = odometer

    @property
    def calibration(self) -> WheelCalibration:
        """See DifferentialBase."""
        return self._odometer.calibration

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        self._odometer.calibration = calibration

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

    # Motions.

    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        """See DifferentialBase."""
        return self._move(distance_m, 0.0, speed_m_s)

    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        """See DifferentialBase."""
        arm_m = self.drivetrain.track_m / 2
        return self._move(0.0, angle_rad * arm_m, turn_rate_rad_s * arm_m)

    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        """See DifferentialBase."""
        wheels_m_s = self.wheel_speeds_m_s(speed_m_s, turn_rate_rad_s)
        left_um_s, right_um_s = (math.trunc(wheel_m_s * _UM) for wheel_m_s in wheels_m_s)
        yield from watched(self._talk, Verb.VEL, (left_um_s, right_um_s, round(timeout_s * 1000)), self._outcome)

    def _move(self, ahead_m: float, arc_m: float, speed_m_s: float) -> Activity:
        """Have the firmware carry out a motion from rest to rest, and watch it."""
        travels_m = self._odometer.calibration.counted(ahead_m, arc_m)
        left_um, right_um = (round(travel_m * _UM) for travel_m in travels_m)
        most_um_s = math.floor(self.drivetrain.max_speed_m_s * _UM + _ROUNDING)
        return self._run(left_um, right_um, min(round(speed_m_s * _UM), most_um_s))

    def _run(self, left_um: int, right_um: int, speed_um_s: int) -> Activity:
        ways_m = left_um / _UM, right_um / _UM
        begun_m = self._odometer.travel_m

        def tell() -> None:
            gone_m = [now - then for now, then in zip(self._odometer.travel_m, begun_m, strict=True)]
            self.progress(_share(gone_m, ways_m))

        is_done = False
        try:
            yield from watched(self._talk, Verb.MOVE, (left_um, right_um, speed_um_s), self._outcome, tell)
            is_done = True
            return 1
        finally:
            if not is_done:
                self.halt()

    def _outcome(self) -> tuple[int, State]:
        wheels = self._talk.latest().wheels
        return wheels.order, State(wheels.state)


def _share(gone_m: Sequence[float], ways_m: Sequence[float]) -> float | None:
    """Return which part of its way a motion has gone, by what the wheels counted; None if it has none."""
    whole_m = sum(map(abs, ways_m))
    ahead_m = sum(gone if way > 0 else -gone for gone, way in zip(gone_m, ways_m, strict=True))
    return ahead_m / whole_m if whole_m else None


def watched(
    talk: Talk,
    verb: Verb,
    numbers: tuple[int, ...],
    outcome: Callable[[], tuple[int, State]],
    tell: Callable[[], None] = lambda: None,
) -> Activity:
    """Give an order for a motion, and wait until it is done.

    Args:
        talk: the talk with the base.
        verb: of the order.
        numbers: of the order.
        outcome: returns the tag of the motion that the channel has begun last, and what became of it.
        tell: called at each look while the motion goes on, to tell of its progress.

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
        if order == tag:
            tell()
        yield max(talk.next_look_s(), LOOK_S)
    if state is State.STALLED:
        raise ResourceFaultError(f"halted: it was driven, and its encoders counted nothing in {STALL_S:g} s")
    if state is State.SILENT:
        raise UnavailableError(f"the base heard nothing for {talk.watchdog_s:g} s, and has stopped by itself")
    if state is not State.DONE:
        raise UnavailableError("the base was stopped")
