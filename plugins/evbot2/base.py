"""The base of an EvBot: requests motions from the firmware and waits for their end."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
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
)

from .messages import OrderChannel, State, Verb, is_newer
from .odometry import Odometer
from .session import POLL_S, BaseSession
from .wheels import STALL_S

_ROUNDING: Final = 1e-9
_UM: Final = 1e6


class Base(DifferentialBase):
    """Drives the robot; get_status: 0 stands, 1 moves, 2 is driven but blocked.

    Args:
        session: the session with the base; this resource polls it.
        odometer: holds the wheel calibration.
        context: of the plugin, for motions to a pose.
    """

    def __init__(
        self, session: BaseSession, odometer: Odometer, drivetrain: Drivetrain, context: PluginContext | None = None
    ) -> None:
        super().__init__(drivetrain, context)
        self._session = session
        self._odometer = odometer

    @property
    @override
    def calibration(self) -> WheelCalibration:
        return self._odometer.calibration

    @calibration.setter
    def calibration(self, calibration: WheelCalibration) -> None:
        self._odometer.calibration = calibration

    def not_ready(self) -> str | None:
        """Return why the base cannot be driven now."""
        return self._session.why_not_ready()

    def background(self) -> Activity:
        """Poll the base for all resources."""
        return self._session.poll()

    def get_status(self) -> int:
        """Return 0 while it stands, 1 while it moves, 2 while something blocks it."""
        wheels = self._session.latest().wheels
        if wheels.state != State.MOVING:
            return 0
        return 2 if wheels.strain else 1

    def halt(self) -> None:
        """Stop at once."""
        self._session.stop(OrderChannel.WHEELS)

    @override
    def drive(self, distance_m: float, speed_m_s: float) -> Activity:
        return self._move(distance_m, 0.0, speed_m_s)

    @override
    def turn(self, angle_rad: float, turn_rate_rad_s: float) -> Activity:
        arm_m = self.drivetrain.track_m / 2
        return self._move(0.0, angle_rad * arm_m, turn_rate_rad_s * arm_m)

    @override
    def follow(self, speed_m_s: float, turn_rate_rad_s: float, timeout_s: float) -> Activity:
        wheels_m_s = self.wheel_speeds_m_s(speed_m_s, turn_rate_rad_s)
        left_um_s, right_um_s = (math.trunc(wheel_m_s * _UM) for wheel_m_s in wheels_m_s)
        numbers = left_um_s, right_um_s, round(timeout_s * 1000)
        yield from run_motion(self._session, Verb.VEL, numbers, self._motion_state)

    def _move(self, ahead_m: float, arc_m: float, speed_m_s: float) -> Activity:
        """Run a motion from rest to rest."""
        travels_m = self._odometer.calibration.counted(ahead_m, arc_m)
        left_um, right_um = (round(travel_m * _UM) for travel_m in travels_m)
        most_um_s = math.floor(self.drivetrain.max_speed_m_s * _UM + _ROUNDING)
        return self._run(left_um, right_um, min(round(speed_m_s * _UM), most_um_s))

    def _run(self, left_um: int, right_um: int, speed_um_s: int) -> Activity:
        lengths_m = left_um / _UM, right_um / _UM
        begun_m = self._odometer.travel_m
        watch = SlipWatch(is_turn=left_um * right_um < 0)

        def report() -> None:
            gone_m = [now - then for now, then in zip(self._odometer.travel_m, begun_m, strict=True)]
            reading = self._session.latest()
            watch.update(reading.stamp_s, sum(map(abs, gone_m)) / 2, is_held=bool(reading.wheels.strain))
            self.progress(_share(gone_m, lengths_m))

        is_done = False
        try:
            yield from run_motion(self._session, Verb.MOVE, (left_um, right_um, speed_um_s), self._motion_state, report)
            is_done = True
            return 1
        finally:
            if not is_done:
                self.halt()

    def _motion_state(self) -> tuple[int, State]:
        wheels = self._session.latest().wheels
        return wheels.order, State(wheels.state)


def _share(gone_m: Sequence[float], lengths_m: Sequence[float]) -> float | None:
    """Return the travelled share of a motion, by encoder counts; None for a motion without length."""
    whole_m = sum(map(abs, lengths_m))
    ahead_m = sum(gone if length > 0 else -gone for gone, length in zip(gone_m, lengths_m, strict=True))
    return ahead_m / whole_m if whole_m else None


def run_motion(
    session: BaseSession,
    verb: Verb,
    numbers: tuple[int, ...],
    state_of: Callable[[], tuple[int, State]],
    report: Callable[[], None] = lambda: None,
) -> Activity:
    """Order a motion, and wait until it is done.

    `state_of` returns the tag and the state of the channel's last motion; `report` is called at each poll meanwhile.

    Raises:
        NotReadyError: the base is absent.
        ResourceFaultError: it refuses the motion, or it is stuck.
        UnavailableError: it has stopped by itself, or does not acknowledge the order.
    """
    tag = yield from session.order(verb, *numbers)
    while True:
        order, state = state_of()
        if order == tag and state is not State.MOVING:
            break
        if is_newer(order, tag):
            raise UnavailableError(f"another order replaced {verb.name}")
        if order == tag:
            report()
        yield max(session.until_next_reading_s(), POLL_S)
    if state is State.STALLED:
        raise ResourceFaultError(f"halted: it was driven, but its encoders counted nothing in {STALL_S:g} s")
    if state is State.SILENT:
        raise UnavailableError(f"the base received nothing for {session.watchdog_s:g} s and has stopped by itself")
    if state is not State.DONE:
        raise UnavailableError("the base was stopped")
