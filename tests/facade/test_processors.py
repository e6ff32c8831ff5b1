"""The threads of many robots of one process share a processor; those of few, and the program's own, use all."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from eal_actors import Fleet
from eal_actors.kernel.processors import CROWD
from eal_actors.managers.config import EALConfigManager

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="needs Linux and two processors"
)


@contextmanager
def fleet_of(robots: int) -> Iterator[Fleet]:
    """Connect sample robots of this process."""
    content = {"version": 1, "robots": {"r{n}": {"count": robots, "plugins": {"sample": {}}}}}
    with Fleet(EALConfigManager.of(content, name="f").fleet).connect() as fleet:
        yield fleet


def processors_of_robots() -> list[set[int]]:
    """Return the processors that each thread of a robot may use."""
    threads = [thread for thread in threading.enumerate() if thread.name.startswith("r")]
    return [os.sched_getaffinity(thread.native_id) for thread in threads if thread.native_id is not None]


def test_a_crowd_shares_a_processor() -> None:
    mine = os.sched_getaffinity(0)
    with fleet_of(CROWD) as fleet:
        used = processors_of_robots()
        assert len(used) == 2 * CROWD  # of each robot and of its resource
        assert len(set.union(*used)) == 1
        assert fleet.read(fleet, "SampleResource").get()
    assert os.sched_getaffinity(0) == mine


def test_few_robots_use_all_processors() -> None:
    with fleet_of(CROWD - 1):
        assert all(used == os.sched_getaffinity(0) for used in processors_of_robots())
