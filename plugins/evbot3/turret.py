"""The turret of an EvBot III."""

from __future__ import annotations

import math
from typing import Final

from typing_extensions import override

from eal_actors.plugin import (
    Activity,
    DataType,
    EALData,
    Resource,
    ResourceType,
    ValueInfo,
    command,
    setting,
)

from ..evbot2.base import run_motion
from ..evbot2.messages import OrderChannel, State, Verb
from ..evbot2.session import BaseSession
from .firmware import MAX_TURRET_RATE_RAD_S
from .status import turret_of

_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", 0, 3600)
_TO_ANGLE: Final = ValueInfo(DataType.DOUBLE, "deg", -360, 360)
_TURN_RATE: Final = ValueInfo(DataType.DOUBLE, "deg/s", 1, round(math.degrees(MAX_TURRET_RATE_RAD_S), 6))
_U: Final = 1e6


class TurretCommands(Resource):
    """The interface of a real and of a simulated turret.

    Args:
        turn_rate_deg_s: the initial turn rate.
    """

    types = ResourceType.ACTUATOR
    value = ValueInfo(DataType.DOUBLE, "rad")

    turn_rate_deg_s: float = setting(_TURN_RATE, "Speed of turning.")

    def __init__(self, turn_rate_deg_s: float) -> None:
        self.turn_rate_deg_s = turn_rate_deg_s

    def swing(self, degrees: float) -> Activity:
        """Turn by an angle, positive to the left."""
        raise NotImplementedError

    def aim(self, degrees: float) -> Activity:
        """Turn to an angle to the left of straight ahead, in the shorter direction."""
        raise NotImplementedError

    @command("l<degrees>", _ANGLE)
    def left_by(self, degrees: float) -> Activity:
        """Turn left by an angle."""
        return self.swing(degrees)

    @command("r<degrees>", _ANGLE)
    def right_by(self, degrees: float) -> Activity:
        """Turn right by an angle."""
        return self.swing(-degrees)

    @command("t<degrees>", _TO_ANGLE, repeatable=True)
    def turn_to(self, degrees: float) -> Activity:
        """Turn to an angle to the left of straight ahead, in the shorter direction."""
        return self.aim(degrees)

    @command("s", urgent=True)
    def stop(self) -> int:
        """Stop at once."""
        self.halt()
        return 1


class Turret(TurretCommands):
    """Turns on the robot; get_status: 0 rests, 1 turns; get_value: its angle in rad, to the left of straight ahead.

    Args:
        session: the session with the base, which Base polls.
    """

    def __init__(self, session: BaseSession) -> None:
        super().__init__(90.0)
        self._session = session

    def not_ready(self) -> str | None:
        """Return why the turret cannot turn now."""
        return self._session.why_not_ready()

    def get_status(self) -> int:
        """Return 0 while it rests, 1 while it turns."""
        return int(turret_of(self._session.latest()).state == State.MOVING)

    def get_value(self) -> EALData:
        """Return its angle relative to the robot, in (-pi, pi]."""
        reading = self._session.latest()
        yaw_rad = min(max(turret_of(reading).yaw_urad / _U, -math.pi), math.pi)
        return EALData.of(yaw_rad, unit="rad", frame_id=f"{self._session.name}/base", stamp_s=reading.stamp_s)

    def halt(self) -> None:
        """Stop at once."""
        self._session.stop(OrderChannel.TURRET)

    @override
    def swing(self, degrees: float) -> Activity:
        return self._turn(Verb.SWING, degrees)

    @override
    def aim(self, degrees: float) -> Activity:
        return self._turn(Verb.AIM, degrees)

    def _turn(self, verb: Verb, degrees: float) -> Activity:
        numbers = tuple(round(math.radians(angle_deg) * _U) for angle_deg in (degrees, self.turn_rate_deg_s))
        begun_rad = last_rad = self._yaw_rad()
        angle_rad = math.radians(degrees)
        if verb is Verb.AIM:
            angle_rad = math.remainder(angle_rad - begun_rad, math.tau)
        gone_rad = 0.0

        def report() -> None:
            nonlocal gone_rad, last_rad
            now_rad = self._yaw_rad()
            gone_rad += math.remainder(now_rad - last_rad, math.tau)
            last_rad = now_rad
            self.progress(gone_rad / angle_rad if angle_rad else None)

        is_done = False
        try:
            yield from run_motion(self._session, verb, numbers, self._motion_state, report)
            is_done = True
            return 1
        finally:
            if not is_done:
                self.halt()

    def _yaw_rad(self) -> float:
        return turret_of(self._session.latest()).yaw_urad / _U

    def _motion_state(self) -> tuple[int, State]:
        turret = turret_of(self._session.latest())
        return turret.order, State(turret.state)
