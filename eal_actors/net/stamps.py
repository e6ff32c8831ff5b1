"""The times of values on their way: each end keeps them by its fleet's clock, the network by the robot's real time."""

from __future__ import annotations

import math

from eal_actors.device.data import EALData
from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.net.offset import MAX_DRIFT
from eal_actors.net.pinging import Pinger
from eal_actors.net.timing import fleet_time_of, real_time_of
from eal_actors.net.wire import RobotTime


def stamp_out(data: EALData, clock: Clock) -> EALData:
    """Return a robot's value as it is sent. Thread: any."""
    return data if data.stamp_s is None else data.with_meta(stamp_s=real_time_of(clock, data.stamp_s))


def stamp_in(data: EALData, clock: Clock) -> EALData:
    """Return a value that a robot was sent, as the robot sees it. Thread: any."""
    return data if data.stamp_s is None else data.with_meta(stamp_s=fleet_time_of(clock, data.stamp_s))


def translated(data: EALData, sent: RobotTime, pinger: Pinger, clock: Clock) -> tuple[EALData, float]:
    """Return a robot's value with its time by our fleet's clock.

    Args:
        data: as it came, with a stamp.
        sent: the robot's clock when it was sent.
        pinger: knows the offset of that clock.
        clock: our fleet's.

    Returns:
        The value, and by how many seconds at most its time is wrong, either way; infinity if nothing bounds it.

    Thread: any.
    """
    came_s, known = REAL_TIME.now(), pinger.latest
    sent_s, error_s = came_s, math.inf
    if known is not None and sent.era in ("", known.era):
        sent_s = min(came_s, sent.time_s - known.offset.offset_s)
        error_s = known.offset.error_s + MAX_DRIFT * max(0.0, came_s - known.at_s)
    age_s = sent.time_s - (data.stamp_s or 0.0)
    return data.with_meta(stamp_s=fleet_time_of(clock, sent_s - age_s)), clock.of_real(error_s)
