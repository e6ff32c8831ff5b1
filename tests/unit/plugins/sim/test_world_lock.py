"""The lock of the simulated world, when a thread that waits for it is given up."""

from __future__ import annotations

import pytest

from eal_actors.kernel.clock import ScaledClock
from eal_actors.kernel.errors import DeadlineError
from tests.net.links import eventually
from tests.robots import WAIT_S, running_robot
from tests.unit.plugins.sim.rig import Fleet


def test_a_thread_that_is_abandoned_while_it_waits_for_the_lock_does_not_keep_it() -> None:
    """A computer that stands still makes calls late and their resources seem stuck; the world must go on."""
    sim = Fleet().add("one")
    world = sim.plugin.world
    with running_robot({"TruePose": lambda: sim.resource("TruePose")}, clock=ScaledClock(20)) as robot:
        with world.lock:
            with pytest.raises(DeadlineError):
                robot["TruePose"].get_value(timeout_s=2.0).get()
            assert eventually(lambda: robot.restarts == {"TruePose": 1})
        assert world.lock.acquire(timeout=WAIT_S)
        world.lock.release()
        assert eventually(lambda: robot["TruePose"].get_value().exception() is None)
