from __future__ import annotations

import threading
from collections.abc import Callable
from itertools import islice
from typing import Any

import numpy as np
import pytest

from eal_actors.device.info import ResourceType
from eal_actors.device.link import FaultyLink
from eal_actors.device.resource import Activity, Resource, command
from eal_actors.kernel.clock import Clock, SystemClock
from eal_actors.kernel.errors import (
    ArgumentError,
    DeadlineError,
    EALError,
    ResourceFaultError,
    UnavailableError,
    UnsupportedError,
)
from eal_actors.kernel.lock_step import LockStepClock
from tests.robots import WAIT_S, running_robot


class Counter(Resource):
    """Counts how often it was read, and does what its commands say when it is read next."""

    types = ResourceType.SENSOR | ResourceType.ACTUATOR

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.count = 0
        self.reading_s = 0.0
        self.next: BaseException | None = None
        self.gate: threading.Event | None = None

    def get_value(self) -> int:
        self.count += 1
        error, self.next = self.next, None
        if error is not None:
            raise error
        if self.gate is not None:
            self.gate.wait(WAIT_S)
        if self.reading_s:
            self.clock.sleep(self.reading_s)
        return self.count

    def get_status(self) -> int:
        return 1

    @command("move")
    def move(self) -> Activity:
        yield 1.0

    def halt(self) -> None: ...


class Camera(Resource):
    """Has an image, or whatever a test puts there."""

    types = ResourceType.SENSOR

    def __init__(self) -> None:
        self.picture: Any = np.zeros((4, 6, 3), np.uint8)

    def get_value(self) -> Any:
        return self.picture


class Quiet(Resource):
    """Has no value."""


def lock_step() -> LockStepClock:
    clock = LockStepClock()
    clock.sleep(0)  # from here on it counts this thread
    return clock


def values_and_times(rate_hz: float, count: int) -> list[tuple[int, float | None]]:
    clock = lock_step()
    with (
        running_robot({"Counter": lambda: Counter(clock)}, clock=clock) as robot,
        robot["Counter"].stream(rate_hz) as stream,
    ):
        return [(data.value, data.stamp_s) for data in islice(stream, count)]


def test_values_come_at_the_rate_and_the_same_on_every_run() -> None:
    told = values_and_times(8, 5)
    assert told == [(1, 0.0), (2, 0.125), (3, 0.25), (4, 0.375), (5, 0.5)]
    assert told == values_and_times(8, 5)


def test_a_slow_reader_gets_the_newest_value_each_once() -> None:
    clock = lock_step()
    with (
        running_robot({"Counter": lambda: Counter(clock)}, clock=clock) as robot,
        robot["Counter"].stream(10) as stream,
    ):
        clock.sleep(1.05)
        newest = next(stream)
        assert (newest.value, newest.stamp_s, stream.skipped) == (11, 1.0, 10)
        assert next(stream).value == 12
        assert clock.now() == pytest.approx(1.1)
        assert stream.skipped == 10


def test_readers_of_different_rates_do_not_hinder_each_other() -> None:
    clock = lock_step()
    with running_robot({"Counter": lambda: Counter(clock)}, clock=clock) as robot:
        counter = robot["Counter"]
        with counter.stream(4) as slow, counter.stream(20) as fast:
            times = [data.stamp_s for data in islice(fast, 21)]
            assert times == pytest.approx([step / 20 for step in range(21)])
            clock.sleep(0)
            assert next(slow).stamp_s == 1.0
            assert slow.skipped == 4


def test_a_slow_resource_is_asked_one_question_at_a_time() -> None:
    clock = lock_step()
    resource = Counter(clock)
    resource.reading_s = 0.25
    with running_robot({"Counter": lambda: resource}, clock=clock) as robot, robot["Counter"].stream(10) as stream:
        assert [data.value for data in islice(stream, 4)] == [1, 2, 3, 4]
        assert clock.now() == pytest.approx(0.25 + 3 * 0.3)


def test_commands_run_and_answer_beside_a_stream() -> None:
    clock = lock_step()
    with (
        running_robot({"Counter": lambda: Counter(clock)}, clock=clock) as robot,
        robot["Counter"].stream(100) as stream,
    ):
        assert next(stream).value == 1
        assert robot["Counter"].send_cmd("move").get() == 1
        assert clock.now() == pytest.approx(1.0)
        assert next(stream).value > 50


def test_a_closed_stream_asks_nothing_more_and_stops_the_iteration() -> None:
    clock = lock_step()
    resource = Counter(clock)
    with running_robot({"Counter": lambda: resource}, clock=clock) as robot:
        with robot["Counter"].stream(10) as stream:
            assert next(stream).value == 1
        stream.close()
        clock.sleep(1.0)
        assert resource.count == 1
        assert list(stream) == []
        assert repr(stream) == "<Stream robot/Counter at 10 Hz: closed>"


def test_closing_wakes_whoever_waits() -> None:
    resource = Counter(SystemClock())
    resource.gate = threading.Event()
    ended = threading.Event()
    with running_robot({"Counter": lambda: resource}) as robot:
        stream = robot["Counter"].stream(10, timeout_s=WAIT_S)

        def read() -> None:
            assert list(stream) == []
            ended.set()

        reader = threading.Thread(target=read)
        reader.start()
        stream.close()
        assert ended.wait(WAIT_S)
        reader.join()
        resource.gate.set()


def test_a_robot_that_is_closed_ends_its_streams_at_once() -> None:
    clock = lock_step()
    with running_robot({"Counter": lambda: Counter(clock)}, clock=clock) as robot:
        stream = robot["Counter"].stream(1, timeout_s=1000.0)
        assert next(stream).value == 1
        robot._actor.shut_down()
        with pytest.raises(UnavailableError, match="robot/Counter: the robot is disconnected"):
            next(stream)
        assert clock.now() < 1.0
        with robot["Counter"].stream(1) as late, pytest.raises(UnavailableError, match="disconnected"):
            next(late)


def test_a_reader_is_told_when_no_value_comes() -> None:
    clock = lock_step()
    resource = Counter(clock)
    resource.reading_s = 5.0
    with (
        running_robot({"Counter": lambda: resource}, clock=clock, timeout_s=30.0) as robot,
        robot["Counter"].stream(10, timeout_s=1.5) as stream,
    ):
        with pytest.raises(DeadlineError, match=r"robot/Counter: no new value came within 1\.5 s"):
            next(stream)
        assert clock.now() == 1.5
        resource.reading_s = 0.0
        clock.sleep(10.0)
        assert next(stream).value > 1


def test_what_get_value_raises_is_raised_at_the_reader_and_the_stream_goes_on() -> None:
    clock = lock_step()
    resource = Counter(clock)
    with running_robot({"Counter": lambda: resource}, clock=clock) as robot, robot["Counter"].stream(10) as stream:
        assert next(stream).value == 1
        resource.next = OSError("no light")
        with pytest.raises(ResourceFaultError, match="no light"):
            next(stream)
        assert next(stream).value == 3


def test_a_stream_goes_on_when_its_resource_has_restarted() -> None:
    clock = lock_step()
    made: list[Counter] = []

    def make() -> Counter:
        made.append(Counter(clock))
        return made[-1]

    with running_robot({"Counter": make}, clock=clock) as robot, robot["Counter"].stream(10) as stream:
        assert next(stream).value == 1
        made[0].next = SystemExit("crash")
        with pytest.raises(ResourceFaultError, match="crash"):
            next(stream)
        assert next(stream).value == 1  # of the new one
        assert len(made) == 2


def test_a_resource_that_is_slow_is_not_restarted_for_it() -> None:
    clock = lock_step()
    made: list[Counter] = []

    def make() -> Counter:
        made.append(Counter(clock))
        made[-1].reading_s = 20.0
        return made[-1]

    with (
        running_robot({"Counter": make}, clock=clock) as robot,
        robot["Counter"].stream(10, timeout_s=60.0) as stream,
    ):
        assert [value.value for value in islice(stream, 3)] == [1, 2, 3]
        assert len(made) == 1
        assert not robot.restarts


def test_a_cut_link_keeps_values_away_until_it_is_whole_again() -> None:
    clock = lock_step()
    link = FaultyLink("robot")
    with (
        running_robot({"Counter": lambda: Counter(clock)}, clock=clock, link=link) as robot,
        robot["Counter"].stream(10, timeout_s=5.0) as stream,
    ):
        assert next(stream).value == 1
        link.impair(is_cut=True)
        with pytest.raises(DeadlineError):
            next(stream)
        link.impair(is_cut=False)
        assert next(stream).value == 2


def test_images_arrive_as_they_are_within_a_process() -> None:
    clock = lock_step()
    camera = Camera()
    with running_robot({"Camera": lambda: camera}, clock=clock) as robot, robot["Camera"].stream(10, "jpeg") as stream:
        assert next(stream).value.shape == (4, 6, 3)
        camera.picture = np.zeros((4, 6), np.uint8)
        with pytest.raises(ArgumentError, match=r"'jpeg' is for images alone.*this value is \|u1 of shape \(4, 6\)"):
            next(stream)


@pytest.mark.parametrize(
    ("open_stream", "error", "message"),
    [
        pytest.param(lambda h: h.stream(0), ArgumentError, "rate_hz must be over 0", id="no rate"),
        pytest.param(lambda h: h.stream(float("nan")), ArgumentError, "rate_hz must be over 0", id="not a number"),
        pytest.param(lambda h: h.stream(timeout_s=float("nan")), ArgumentError, "timeout_s must be", id="no time-out"),
        pytest.param(lambda h: h.stream(1001), ArgumentError, "up to 1000, not 1001", id="too fast"),
        pytest.param(lambda h: h.stream(10, "gif"), ArgumentError, "raw, jpeg, png, not 'gif'", id="encoding"),
        pytest.param(lambda h: h.stream(10), UnsupportedError, "robot/Quiet: has no get_value", id="no value"),
    ],
)
def test_what_cannot_be_streamed(open_stream: Callable[[Any], Any], error: type[EALError], message: str) -> None:
    with running_robot({"Quiet": Quiet}) as robot, pytest.raises(error, match=message):
        open_stream(robot["Quiet"])
