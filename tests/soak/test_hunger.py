"""The kernel reports processes that wait for processor time."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from eal_actors.kernel.clock import REAL_TIME
from tests.soak.hunger import HUNGRY_S, Hunger

SPINNING = "while True: pass"
WAITING = "import sys; print('up', flush=True); sys.stdin.read()"


@pytest.fixture
def processes() -> Iterator[list[subprocess.Popen[bytes]]]:
    started: list[subprocess.Popen[bytes]] = []
    yield started
    for process in started:
        process.kill()
        process.communicate()


@pytest.mark.skipif(not Path("/proc/self/schedstat").exists(), reason="needs a kernel that keeps the account")
def test_of_two_that_share_one_processor_both_are_hungry(processes: list[subprocess.Popen[bytes]]) -> None:
    processor = min(os.sched_getaffinity(0))
    for _ in range(2):
        processes.append(subprocess.Popen([sys.executable, "-c", SPINNING]))
        os.sched_setaffinity(processes[-1].pid, {processor})
    hunger, clock, missing = Hunger(), REAL_TIME, {process.pid for process in processes}
    end_s = clock.now() + 60.0
    while missing and clock.now() < end_s:
        for pid in sorted(missing):
            if (wait := hunger.look(pid, clock.now())) is not None and wait[1] >= HUNGRY_S:
                assert wait[0][1] - wait[0][0] >= wait[1]
                missing.discard(pid)
        clock.sleep(3 * HUNGRY_S)
    assert not missing


def test_who_waits_for_something_else_is_not_hungry(processes: list[subprocess.Popen[bytes]]) -> None:
    process = subprocess.Popen([sys.executable, "-c", WAITING], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    processes.append(process)
    assert process.stdout is not None
    assert process.stdout.readline() == b"up\n"
    hunger = Hunger()
    assert hunger.look(process.pid, 10.0) is None
    assert hunger.look(process.pid, 20.0) is None


def test_who_has_ended_is_not_hungry(processes: list[subprocess.Popen[bytes]]) -> None:
    process = subprocess.Popen([sys.executable, "-c", WAITING], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    processes.append(process)
    hunger = Hunger()
    assert hunger.look(process.pid, 10.0) is None
    process.communicate()
    assert hunger.look(process.pid, 20.0) is None
