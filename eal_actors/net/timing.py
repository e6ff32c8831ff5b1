"""Between a fleet's clock, which may run at any rate, and the real time of its process, in which the network counts."""

from __future__ import annotations

from eal_actors.kernel.clock import REAL_TIME, Clock


def real_time_of(clock: Clock, fleet_s: float) -> float:
    """Return the real time (REAL_TIME) at which a fleet's clock shows a time. Thread: any."""
    return REAL_TIME.now() + (fleet_s - clock.now()) / clock.of_real(1.0)


def fleet_time_of(clock: Clock, real_s: float) -> float:
    """Return what a fleet's clock shows at a real time (REAL_TIME). Thread: any."""
    return clock.now() + clock.of_real(real_s - REAL_TIME.now())
