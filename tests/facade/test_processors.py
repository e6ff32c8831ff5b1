"""The threads of many robots of one process share a processor; no thread of a fleet preempts the one that wakes it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
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


def run(action: Callable[[], None]) -> None:
    """Run an action in a thread of its own."""
    thread = threading.Thread(target=action)
    thread.start()
    thread.join()


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


def test_a_crowd_starts_where_processors_cannot_be_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setaffinity", refuse)
    with fleet_of(CROWD) as fleet:
        assert fleet.read(fleet, "SampleResource").get()


def test_threads_of_a_fleet_do_not_preempt_those_that_wake_them() -> None:
    policies: list[int] = []

    def connect() -> None:  # in a thread, since the policy stays
        with fleet_of(1):
            threads = [thread.native_id or 0 for thread in threading.enumerate() if thread.name.startswith("r")]
            policies.extend(os.sched_getscheduler(thread) for thread in (0, *threads))

    run(connect)
    assert policies == [os.SCHED_BATCH] * 3


def test_a_policy_that_the_user_has_chosen_stays() -> None:
    policies: list[int] = []

    def connect() -> None:
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        with fleet_of(1):
            policies.append(os.sched_getscheduler(0))

    run(connect)
    assert policies == [os.SCHED_IDLE]
