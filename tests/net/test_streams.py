"""Streams over the network: published while a reader exists, newest first, and resumed when the robot returns."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
import zenoh

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.device.data.images import Encoding
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import ArgumentError, DeadlineError, EALError, UnavailableError, UnsupportedError
from eal_actors.wire.format.frames import LEASE_S
from eal_actors.wire.session import controller_config, open_session
from tests.net.links import eventually
from tests.net.rig import WAIT_S, Rig, becomes, process, ready, servers

READER = """
import sys
from eal_actors import Fleet

with Fleet.load(sys.argv[1]) as fleet, fleet["r1"]["Eye"].stream(50) as frames:
    for frame in frames:
        print("frame", frame.shape, flush=True)
"""


class Watcher:
    """Counts a robot's published samples without subscribing as a reader."""

    def __init__(self) -> None:
        self.clock = SystemClock()
        self.keys: list[str] = []
        self.last_s = 0.0

    def take(self, sample: zenoh.Sample) -> None:
        self.keys.append(str(sample.key_expr).removeprefix("eal/f/@streams/r1/"))
        self.last_s = self.clock.now()

    def silent_for(self, seconds: float) -> bool:
        return self.clock.now() - self.last_s > seconds


@contextmanager
def watching(rig: Rig) -> Iterator[Watcher]:
    watcher = Watcher()
    with open_session(controller_config(rig.config)) as session:
        handler = zenoh.handlers.Callback(watcher.take, indirect=False)
        with session.declare_subscriber("eal/f/@streams/r1/**", handler):
            yield watcher


@pytest.mark.parametrize("encoding", ["raw", "png", "jpeg"])
def test_frames_arrive_in_every_encoding(fleet: Fleet, encoding: Encoding) -> None:
    eye = fleet["r1"]["Eye"]
    true = eye.get_value().get().value
    with eye.stream(20, encoding) as stream:
        for frame in (next(stream), next(stream)):
            difference = np.abs(frame.value.astype(int) - true)
            assert difference.mean() < 4 if encoding == "jpeg" else difference.max() == 0
            assert frame.stamp_s is not None
            assert 0 <= fleet.clock.now() - frame.stamp_s < WAIT_S


def test_the_rate_is_kept(fleet: Fleet) -> None:
    with fleet["r1"]["Gauge"].stream(40) as stream:
        stamps = [next(stream).stamp_s or 0.0 for _ in range(21)]
    assert 0.4 < stamps[-1] - stamps[0] < 5.0  # 20 periods are 0.5 s; more where the machine is busy
    assert stamps == sorted(stamps)


def test_a_slow_reader_gets_the_newest_frame_and_keeps_one(fleet: Fleet) -> None:
    with fleet["r1"]["Eye"].stream(50) as stream:
        next(stream)
        assert eventually(lambda: stream.skipped > 20)
        asked_s = fleet.clock.now()
        frame = next(stream)
        assert frame.stamp_s is not None
        assert asked_s - frame.stamp_s < 0.3  # the oldest of them is 0.4 s old


def test_readers_of_different_rates_get_what_they_asked_for(rig: Rig, fleet: Fleet) -> None:
    gauge = fleet["r1"]["Gauge"]
    with watching(rig) as watcher, gauge.stream(5) as slow, gauge.stream(50) as fast, gauge.stream(50) as other:
        slow_stamps = [next(slow).stamp_s or 0.0 for _ in range(3)]
        fast_stamps = [next(fast).stamp_s or 0.0 for _ in range(11)]
        assert next(other).value == -42
        assert min(np.diff(slow_stamps)) > 0.1
        assert min(np.diff(fast_stamps)) < 0.1
        assert eventually(lambda: {"Gauge/raw/5", "Gauge/raw/50"} == set(watcher.keys))


def test_nothing_is_published_when_nobody_asks(rig: Rig, fleet: Fleet) -> None:
    gauge = fleet["r1"]["Gauge"]
    with watching(rig) as watcher:
        with gauge.stream(50) as first, gauge.stream(50) as second:
            next(first)
            first.close()
            assert next(second).value == -42  # the other reader of the same stream still receives samples
            assert next(second).value == -42
            assert eventually(lambda: watcher.keys)
        assert eventually(lambda: watcher.silent_for(0.3))
        counted = len(watcher.keys)
        assert fleet["r1"]["Gauge"].get_value().get().value == -42
        assert len(watcher.keys) == counted


def test_a_reader_that_is_killed_is_published_for_no_longer_than_its_lease(rig: Rig, fleet: Fleet) -> None:
    with watching(rig) as watcher, process(["-c", READER, str(rig.file)], rig.folder) as reader:
        reader.wait_for("frame")
        assert eventually(lambda: watcher.keys)
        reader.kill()
        killed_s = watcher.clock.now()
        assert eventually(lambda: watcher.silent_for(0.5))
        assert watcher.last_s - killed_s < LEASE_S + 1.0


def test_a_stream_goes_on_when_the_robot_is_back(rig: Rig) -> None:
    with servers(rig) as running, ready(Fleet(rig.config)) as fleet:
        robot = fleet["r1"]
        with robot["Gauge"].stream(20, timeout_s=0.3) as hasty, robot["Gauge"].stream(20) as patient:
            assert next(hasty).value == next(patient).value == -42
            running["r1"].kill()
            assert becomes(robot, RobotState.LOST)
            with pytest.raises(UnavailableError, match="r1/Gauge: the robot is unreachable"):
                list(hasty)
            running.start("r1")
            for value, _ in zip(patient, range(3), strict=False):
                back = value
            assert back.value == -42
            assert back.stamp_s is not None
            assert abs(fleet.clock.now() - back.stamp_s) < WAIT_S  # of the new run's clock, in our time
            assert robot.state is RobotState.READY


def test_a_closed_fleet_ends_its_streams(rig: Rig) -> None:
    with rig.served_here() as fleet:
        stream = fleet["r1"]["Gauge"].stream(20)
        next(stream)
        fleet.close()
        with pytest.raises(UnavailableError, match="the robot is disconnected"):
            list(stream)
        stream.close()


def test_a_cut_link_keeps_frames_away(fleet: Fleet) -> None:
    link = fleet.services.link("r1")
    with fleet["r1"]["Gauge"].stream(20, timeout_s=0.3) as stream:
        next(stream)
        link.impair(is_cut=True)
        with pytest.raises(DeadlineError):
            list(stream)
        link.impair(is_cut=False)
        assert next(stream).value == -42


@pytest.mark.parametrize(
    ("resource", "encoding", "kind", "message"),
    [
        pytest.param("Arm", "jpeg", ArgumentError, "r1/Arm: the encoding 'jpeg' is for images alone", id="no image"),
        pytest.param("Line", "raw", UnsupportedError, "r1/Line: has no get_value", id="no value"),
    ],
)
def test_what_cannot_be_streamed(
    fleet: Fleet, resource: str, encoding: Encoding, kind: type[EALError], message: str
) -> None:
    with pytest.raises(kind, match=message):
        fleet["r1"][resource].stream(10, encoding)


def test_a_reader_without_opencv_is_told_what_to_install(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cv2", None)
    with pytest.raises(UnsupportedError, match=r"install eal-actors\[vision\]"):
        fleet["r1"]["Eye"].stream(10, "jpeg")
