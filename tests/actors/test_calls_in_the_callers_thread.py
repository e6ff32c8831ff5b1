"""Calls that run in the caller's thread, where a resource allows any thread: same order, one at a time, same errors."""

from __future__ import annotations

import threading
from collections.abc import Generator
from typing import Any

import numpy as np
import pytest

from eal_actors import gather
from eal_actors.actors.many import read_many, send_many
from eal_actors.device.data import DataType
from eal_actors.device.info import ResourceType, ValueInfo
from eal_actors.device.resource import Resource, command
from eal_actors.kernel import lock_step
from eal_actors.kernel.errors import EALError, ResourceFaultError, UnavailableError
from eal_actors.kernel.lock_step import LockStepClock
from tests.robots import WAIT_S, running_robot


class Counter(Resource):
    """Counts its readings and the threads that run them; fails if two are inside at once."""

    types = ResourceType.SENSOR
    value = ValueInfo(DataType.INT)
    any_thread = True

    def __init__(self) -> None:
        self.count = 0
        self.threads: list[str] = []
        self.inside = threading.Lock()
        self.raises: BaseException | None = None

    def get_value(self) -> int:
        assert self.inside.acquire(blocking=False), "two threads are inside"
        try:
            if self.raises is not None:
                error, self.raises = self.raises, None
                raise error
            self.threads.append(threading.current_thread().name)
            count = self.count
            for _ in range(20):  # time for another thread to come in
                self.count = count
            self.count = count + 1
            return self.count
        finally:
            self.inside.release()

    @command("wait")
    def wait(self) -> Generator[float, None, int]:
        self.threads.append(threading.current_thread().name)
        yield 0.5
        self.threads.append(threading.current_thread().name)
        return 7


class Bound(Counter):
    """Must have its own thread."""

    any_thread = False


def my_name() -> str:
    return threading.current_thread().name


def test_in_lock_step_a_call_runs_in_the_callers_thread_if_the_resource_allows_that() -> None:
    clock, free, bound = LockStepClock(), Counter(), Bound()
    clock.sleep(0)
    with running_robot({"Free": lambda: free, "Bound": lambda: bound}, clock=clock) as robot:
        calls = [robot[name].get_value() for name in ("Free", "Bound")]
        assert [call.done() for call in calls] == [True, False]
        assert [call.get().value for call in calls] == [1, 1]
    assert (free.threads, bound.threads) == ([my_name()], ["robot/Bound"])


def test_a_call_behind_others_waits_for_its_turn() -> None:
    clock, free = LockStepClock(), Counter()
    clock.sleep(0)
    with running_robot({"Free": lambda: free}, clock=clock) as robot:
        status = robot["Free"].get_status()  # urgent calls wait in the mailbox
        value = robot["Free"].get_value()
        assert not value.done()
        assert value.get().value == 1
        assert isinstance(status.exception(), EALError)
    assert free.threads == ["robot/Free"]


def test_an_activity_begun_by_a_caller_goes_on_in_the_actor_and_is_pre_empted_by_the_next() -> None:
    clock, free = LockStepClock(), Counter()
    clock.sleep(0)
    with running_robot({"Free": lambda: free}, clock=clock) as robot:
        first = robot["Free"].send_cmd("wait")
        second = robot["Free"].send_cmd("wait")
        assert "took over" in str(first.exception())
        assert (second.get(), clock.now()) == (7, 0.5)
    # The second call found the actor about to set its timer for the first.
    assert free.threads == [my_name(), "robot/Free", "robot/Free"]


def test_a_thread_that_polls_does_not_keep_time_from_advancing() -> None:
    clock, free = LockStepClock(), Counter()
    clock.sleep(0)
    with running_robot({"Free": lambda: free}, clock=clock) as robot:
        waiting = robot["Free"].send_cmd("wait")
        for _ in range(100_000):
            read_many([robot["Free"]])[0].get()
            if waiting.done():
                break
        assert waiting.done()


@pytest.mark.parametrize("lock_step", [True, False])
def test_errors_are_those_of_the_mailbox(lock_step: bool) -> None:
    clock = LockStepClock() if lock_step else None
    free = Counter()
    if clock is not None:
        clock.sleep(0)
    with running_robot({"Free": lambda: free}, clock=clock) as robot:
        free.raises = OSError("no such wire")
        [call] = read_many([robot["Free"]])
        error = call.exception()
        assert isinstance(error, ResourceFaultError)
        assert "no such wire" in str(error)
        free.raises = KeyboardInterrupt()  # Ctrl-C in the middle of the caller's call is the caller's
        with pytest.raises(KeyboardInterrupt):
            read_many([robot["Free"]])
        [call] = read_many([robot["Free"]])
        assert call.get().value == 1
        free.raises = SystemExit(3)  # a crash is the resource's: the caller lives on, and the robot starts it anew
        [call] = read_many([robot["Free"]])
        assert isinstance(call.exception(), ResourceFaultError)
        states: list[EALError | int] = []
        while not states or not isinstance(states[-1], int):
            [call] = read_many([robot["Free"]])
            error = call.exception()
            assert error is None or isinstance(error, UnavailableError)
            states.append(call.get().value if error is None else error)
            robot.clock.sleep(0.05)
        assert robot.restarts == {"Free": 1}


@pytest.mark.parametrize("seed", range(2))
def test_callers_of_many_never_run_a_resource_twice_at_once_nor_out_of_order(seed: int) -> None:
    names = [f"Free{number}" for number in range(8)]
    counters = {name: Counter() for name in names}
    rounds = 40
    failures: list[object] = []

    def call_often(number: int) -> None:
        chance = np.random.default_rng([seed, number])
        try:
            for _ in range(rounds):
                handles = [robot[name] for name in chance.choice(names, 5, replace=False).tolist()]
                ones = [handle.get_value() for handle in handles] if chance.random() < 0.5 else []
                manys = read_many(handles)
                pairs = zip(gather(ones).get(), gather(manys).get(), strict=True) if ones else []
                failures.extend(pair for pair in pairs if not pair[0].value < pair[1].value)
                gather(manys).get()
        except BaseException as error:  # noqa: BLE001  # the assertion below shows it
            failures.append(error)

    makers: dict[str, Any] = {name: (lambda counter=counter: counter) for name, counter in counters.items()}
    with running_robot(makers) as robot:
        threads = [threading.Thread(target=call_often, args=(number,)) for number in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(WAIT_S * 6)
            assert not thread.is_alive()
        assert failures == []
        total = sum(len(counter.threads) for counter in counters.values())
        assert sum(counter.count for counter in counters.values()) == total
        here = sum(name.startswith("Thread") for counter in counters.values() for name in counter.threads)
        assert 0 < here < total


def test_a_command_to_many_runs_here_and_a_stop_goes_first() -> None:
    frees = [Counter(), Counter()]
    with running_robot({"A": lambda: frees[0], "B": lambda: frees[1]}) as robot:
        calls = send_many([robot["A"], robot["B"]], "wait")
        assert [free.threads for free in frees] == [[my_name()], [my_name()]]
        assert gather(calls).get() == [7, 7]
        assert [free.threads[1] for free in frees] == ["robot/A", "robot/B"]


class Beat(Counter):
    """Notes the thread of each of its beats."""

    @command("beat")
    def beat(self) -> Generator[float, None, int]:
        for _ in range(4):
            yield 0.5
            if self.raises is not None:
                raise self.raises
            self.threads.append(threading.current_thread().name)
        return 4


class BoundBeat(Beat):
    """Must have its own thread."""

    any_thread = False


@pytest.mark.parametrize("kind", [Beat, BoundBeat])
def test_in_lock_step_one_thread_takes_the_steps_of_all_resources_that_allow_that(kind: type[Beat]) -> None:
    clock, beats = LockStepClock(), {f"Beat{number}": kind() for number in range(20)}
    clock.sleep(0)
    makers: dict[str, Any] = {name: (lambda beat=beat: beat) for name, beat in beats.items()}
    with running_robot(makers, clock=clock) as robot:
        running = [robot[name].send_cmd("beat") for name in beats]
        assert gather(running).get() == [4] * 20
        assert clock.now() == 2.0
    threads = {thread for beat in beats.values() for thread in beat.threads}
    assert len(threads) == (20 if kind is BoundBeat else 1)


def test_a_crash_in_the_thread_of_another_resource_is_its_own() -> None:
    clock, healthy, broken = LockStepClock(), Beat(), Beat()
    clock.sleep(0)
    with running_robot({"Healthy": lambda: healthy, "Broken": lambda: broken}, clock=clock) as robot:
        beats = [
            robot[name].send_cmd("beat") for name in ("Broken", "Healthy")
        ]  # the last one to wait serves the other
        clock.sleep(0.75)
        broken.raises = SystemExit(3)
        error = beats[0].exception()
        assert isinstance(error, ResourceFaultError)
        assert "Broken" in str(error)
        assert beats[1].get() == 4
        assert set(broken.threads) == {"robot/Healthy"}
        broken.raises = None
        assert robot["Broken"].send_cmd("beat").get() == 4  # it has been started anew
        assert robot.restarts == {"Broken": 1}


class Stuck(Beat):
    """Never ends its second step."""

    @command("beat")
    def beat(self) -> Generator[float, None, int]:
        yield 0.5
        self.threads.append(threading.current_thread().name)
        while self.count >= 0:
            self.count += 1
        return 1


@pytest.mark.slow
def test_a_resource_that_is_stuck_in_the_thread_of_another_is_abandoned_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock_step, "_PATIENCE_S", 0.5)  # of processor time, until time goes on
    clock, healthy, stuck = LockStepClock(), Beat(), Stuck()
    clock.sleep(0)
    with running_robot({"Healthy": lambda: healthy, "Stuck": lambda: stuck}, clock=clock, timeout_s=1.0) as robot:
        beats = [robot[name].send_cmd("beat", timeout_s=1e6) for name in ("Healthy", "Stuck")]
        while not all(beat.done() for beat in beats):
            clock.sleep(0.1)  # without a sleeper, time would jump to the deadlines while that thread unwinds
        error = beats[1].exception()
        assert isinstance(error, EALError)
        assert "Stuck" in str(error)
        assert stuck.threads == ["robot/Healthy"]
        assert beats[0].get() == 4
        assert robot["Healthy"].send_cmd("beat", timeout_s=1e6).get() == 4
