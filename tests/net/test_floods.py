"""Stops are confirmed while the network is full of other calls and values."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from eal_actors import Fleet
from eal_actors.actors.handles import RobotHandle
from tests.net.host import crowd
from tests.net.rig import WAIT_S, Process, Rig, process, ready

ROBOTS = 20
BIG = bytes(900_000)
FLOODS: dict[str, Callable[[RobotHandle], Any]] = {
    "images": lambda robot: robot["Eye"].get_value(),
    "large values": lambda robot: robot["Eye"].set_value(BIG),
    "readings": lambda robot: robot["Gauge"].get_value(),
    "commands": lambda robot: robot["Arm"].send_cmd("step1"),
}


@contextmanager
def hosted(folder: Path) -> Iterator[tuple[Process, Fleet]]:
    """Serve robots by one other process, and connect to them."""
    rig = Rig(folder, network={"shared_memory": False})  # images are to fill the link
    with process(["-m", "tests.net.host", str(rig.file), str(ROBOTS)], folder) as host:
        host.wait_until_listening()
        with ready(Fleet(crowd(rig.config, ROBOTS))) as fleet:
            yield host, fleet


class Flood:
    """Calls all robots again and again, for the length of a `with` block.

    Attributes:
        calls: number of calls.
    """

    def __init__(self, fleet: Fleet, call: Callable[[RobotHandle], Any]) -> None:
        self._robots = list(fleet.values())
        self._call = call
        self._ends = threading.Event()
        self._reached = threading.Condition()
        self.calls = 0
        self._thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self._ends.is_set():
            for robot in self._robots:
                self._call(robot)
            with self._reached:
                self.calls += len(self._robots)
                self._reached.notify_all()

    def wait_for_more(self, count: int) -> None:
        """Wait until it has made so many more calls."""
        with self._reached:
            target = self.calls + count
            assert self._reached.wait_for(lambda: self.calls >= target, WAIT_S)

    def __enter__(self) -> Flood:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ends.set()
        self._thread.join(WAIT_S)


def confirm_stops(folder: Path, kind: str) -> int:
    """Stop and resume all robots three times during a flood; return the most memory that their process took."""
    with hosted(folder) as (host, fleet), Flood(fleet, FLOODS[kind]) as flood:
        flood.wait_for_more(300 * ROBOTS)
        for _ in range(3):
            stops = [robot.stop("a flood") for robot in fleet.values()]
            assert [stop.exception(timeout=WAIT_S) for stop in stops] == [None] * ROBOTS
            flood.wait_for_more(ROBOTS)
            resumes = [robot.resume() for robot in fleet.values()]
            assert [resume.exception(timeout=WAIT_S) for resume in resumes] == [None] * ROBOTS
        return host.peak_memory_bytes()


def test_stops_are_confirmed_during_a_flood_of_images_which_takes_bounded_memory(tmp_path: Path) -> None:
    assert confirm_stops(tmp_path, "images") < 400_000_000  # 256 images for each robot are 4.7 GB


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["large values", "readings", "commands"])
def test_stops_are_confirmed_during_other_floods(tmp_path: Path, kind: str) -> None:
    confirm_stops(tmp_path, kind)
