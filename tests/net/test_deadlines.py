"""No command begins or moves after its deadline, however slow the link is: judged by what the device writes down."""

from __future__ import annotations

import random
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.actors.future import Future
from eal_actors.kernel.errors import DeadlineError
from tests.net.links import eventually, free_port
from tests.net.rig import WAIT_S, Rig, failure, ready, servers
from tests.soak.proxy import Cables

AWAY_S, BACK_S = (0.02, 0.5), (0.03, 0.3)
"""Shortest and longest delays of a link, to the robot and back, in seconds."""
TTL_S = 1.0
BURST = 40


def monotonic_s() -> float:
    """Return the machine's monotonic time, by which robots write their notes."""
    return time.clock_gettime(time.CLOCK_MONOTONIC)


@contextmanager
def slow_link(folder: Path) -> Iterator[tuple[Rig, Fleet, Cables]]:
    """Serve a robot in a process of its own, and connect to it over a cable that can be slowed."""
    rig, port, robot_port = Rig(folder, network={"lease_s": 5.0, "dead_man_s": 5.0}), free_port(), free_port()
    rig.content["robots"]["r1"] |= {"address": f"tcp/127.0.0.1:{port}", "listen": f"tcp/127.0.0.1:{robot_port}"}
    rig.write()
    with Cables({"r1": (port, robot_port)}) as cables, servers(rig), ready(Fleet(rig.config)) as fleet:
        yield rig, fleet, cables


@dataclass
class Tally:
    """Commands and their deadlines.

    Attributes:
        deadlines: the latest machine time at which each may begin.
        easy: commands whose deadline leaves more than enough time.
    """

    deadlines: dict[str, float] = field(default_factory=dict)
    easy: set[str] = field(default_factory=set)
    done: set[str] = field(default_factory=set)

    def send_burst(self, fleet: Fleet, choose: random.Random, away_s: float, back_s: float) -> Sequence[Future[int]]:
        """Send commands whose deadlines are below and above the delay."""
        calls = []
        for _ in range(BURST):
            number = str(len(self.deadlines))
            timeout_s = choose.uniform(0.3, 4.0) * away_s
            call = fleet["r1"]["Arm"].send_cmd(f"step{number}", timeout_s=timeout_s)
            self.deadlines[number] = monotonic_s() + timeout_s
            if timeout_s > 2 * (away_s + back_s) + 0.2 and away_s + back_s < TTL_S / 2:
                self.easy.add(number)
            calls.append(call)
        return calls

    def late_s(self, rig: Rig) -> list[float]:
        """Return by how much commands began after their deadlines."""
        late = (note.time_s - self.deadlines[note.what] for note in rig.notes("step"))
        return [late_s for late_s in late if late_s > 0]


def send_over_slow_links(folder: Path, seed: int, bursts: int) -> Tally:
    """Send bursts over links of random delays; assert that no command begins late or twice, and that others begin."""
    choose, tally = random.Random(seed), Tally()  # noqa: S311  # a test
    with slow_link(folder) as (rig, fleet, cables):
        for _ in range(bursts):
            away_s, back_s = choose.uniform(*AWAY_S), choose.uniform(*BACK_S)
            cables.slow("r1", away_s, back_s)
            for call in tally.send_burst(fleet, choose, away_s, back_s):
                call.exception(timeout=WAIT_S)
        cables.mend("r1")
        assert fleet["r1"]["Arm"].get_value().get(timeout=WAIT_S).value == 0  # what was on its way has arrived
        begun = rig.steps()
    late = tally.late_s(rig)
    told = f"seed {seed}: {len(tally.deadlines)} commands, {len(begun)} begun, late: {len(late)}, by {late[:5]} s"
    sys.stdout.write(f"{told}\n")
    assert not late, told
    assert len(begun) == len(set(begun)), told
    assert len(tally.easy & set(begun)) >= 0.5 * len(tally.easy), told
    assert 0 < len(begun) < len(tally.deadlines), told
    return tally


def test_no_command_begins_after_its_deadline_on_slow_links(tmp_path: Path) -> None:
    send_over_slow_links(tmp_path, seed=7, bursts=6)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_none_of_twenty_thousand_commands_begins_after_its_deadline(tmp_path: Path) -> None:
    tally = send_over_slow_links(tmp_path, seed=11, bursts=500)
    assert len(tally.deadlines) >= 20_000


def test_a_command_that_waits_on_the_way_until_its_deadline_never_begins(tmp_path: Path) -> None:
    with slow_link(tmp_path) as (rig, fleet, cables):
        cables.slow("r1", 0.4, 0.03)
        calls = [fleet["r1"]["Arm"].send_cmd(f"step{n}", timeout_s=0.2) for n in range(30)]
        for call in calls:
            failure(call, DeadlineError)
        cables.mend("r1")
        assert fleet["r1"]["Arm"].get_value().get(timeout=WAIT_S).value == 0
        assert rig.steps() == []


def test_the_robot_stops_a_motion_at_its_deadline_counted_from_the_sending(tmp_path: Path) -> None:
    with slow_link(tmp_path) as (rig, fleet, cables):
        cables.slow("r1", 0.3, 0.3)
        call = fleet["r1"]["Arm"].send_cmd("move5", timeout_s=1.2)
        deadline_s = monotonic_s() + 1.2
        failure(call, DeadlineError)
        assert eventually(lambda: rig.notes("halt"))
        assert [note.what for note in rig.notes("begin")] == ["move5"]
        assert rig.notes("halt")[0].time_s <= deadline_s
