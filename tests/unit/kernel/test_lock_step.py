"""A clock that jumps, and lets one thread run at a time."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable

import pytest
from structlog.testing import capture_logs

from eal_actors.kernel.clock import ScaledClock, new_waiter
from eal_actors.kernel.lock_step import MAX, LockStepClock, clock_of

ENOUGH_S = 20.0
"""Real seconds after which a test that waits has failed."""


def run_together(clock: LockStepClock, *targets: Callable[[], None]) -> None:
    """Start a thread for each target in one go, and wait until all have ended."""
    threads = [threading.Thread(target=target, name=f"thread {number}") for number, target in enumerate(targets)]
    clock.sleep(0)
    for thread in threads:
        clock.start(thread)
    with clock.outside():
        for thread in threads:
            thread.join(ENOUGH_S)
    assert not any(thread.is_alive() for thread in threads)


def test_a_sleep_takes_no_time_but_the_clocks() -> None:
    clock = LockStepClock()
    before_s = ScaledClock().now()
    clock.sleep(3600.0)
    assert clock.now() == 3600.0
    assert ScaledClock().now() - before_s < ENOUGH_S


def test_time_stands_still_while_a_thread_computes() -> None:
    clock = LockStepClock()
    clock.sleep(1.0)
    assert sum(range(100_000)) > 0
    assert clock.now() == 1.0


def test_sleepers_wake_in_the_order_of_their_times_and_then_of_their_sleeps() -> None:
    clock = LockStepClock()
    woken: list[tuple[str, float]] = []

    def sleeper(name: str, *naps_s: float) -> Callable[[], None]:
        def sleep() -> None:
            for nap_s in naps_s:
                clock.sleep(nap_s)
                woken.append((name, clock.now()))

        return sleep

    run_together(clock, sleeper("a", 2.0, 2.0), sleeper("b", 1.0, 1.0, 2.0), sleeper("c", 4.0))
    assert woken == [("b", 1.0), ("a", 2.0), ("b", 2.0), ("c", 4.0), ("a", 4.0), ("b", 4.0)]


def test_a_wake_up_comes_before_time_goes_on() -> None:
    clock = LockStepClock()
    waiter = new_waiter()
    heard: list[tuple[object, float]] = []

    def wait() -> None:
        heard.append((clock.wait(waiter, 5.0), clock.now()))
        heard.append((clock.wait(waiter, 5.0), clock.now()))

    def wake() -> None:
        clock.sleep(1.0)
        clock.wake(waiter)
        heard.append(("woke", clock.now()))

    run_together(clock, wait, wake)
    assert heard == [("woke", 1.0), (True, 1.0), (False, 6.0)]


def test_a_waiter_released_beforehand_is_not_waited_for() -> None:
    clock, waiter = LockStepClock(), new_waiter()
    clock.wake(waiter)
    clock.wake(waiter)
    assert clock.wait(waiter, 5.0)
    assert clock.now() == 0.0
    assert not clock.wait(waiter, 5.0)
    assert clock.now() == 5.0


def test_a_sleep_of_nothing_lets_the_others_go_first() -> None:
    clock, order = LockStepClock(), []

    def work(name: str) -> Callable[[], None]:
        def run() -> None:
            for _ in range(3):
                order.append(name)
                clock.sleep(0)

        return run

    run_together(clock, work("a"), work("b"), work("c"))
    assert order == ["a", "b", "c"] * 3


def test_threads_run_one_at_a_time() -> None:
    clock, inside, most = LockStepClock(), [0], [0]

    def work() -> None:
        for _ in range(50):
            inside[0] += 1
            most[0] = max(most[0], inside[0])
            sum(range(2000))
            inside[0] -= 1
            clock.sleep(0.1)

    run_together(clock, *[work] * 8)
    assert most == [1]
    assert clock.now() == pytest.approx(5.0)


def test_a_thread_outside_does_not_hold_up_time() -> None:
    clock, ended = LockStepClock(), threading.Event()

    def sleep() -> None:
        clock.sleep(10.0)
        ended.set()

    clock.sleep(0)
    clock.start(threading.Thread(target=sleep, daemon=True))
    with clock.outside():
        assert ended.wait(ENOUGH_S)
    assert clock.now() == 10.0


def test_a_thread_that_waits_for_something_else_loses_its_turn_and_is_named() -> None:
    clock, ended = LockStepClock(), threading.Event()

    def sleep() -> None:
        clock.sleep(10.0)
        ended.set()

    clock.sleep(0)
    with capture_logs() as logs:
        clock.start(threading.Thread(target=sleep, daemon=True))
        assert ended.wait(ENOUGH_S)  # this thread still has the turn: only the watch can help
    assert [log["thread"] for log in logs] == ["MainThread"]
    assert clock.now() == 10.0
    clock.sleep(1.0)  # and it counts again
    assert clock.now() == 11.0


def test_a_wait_on_the_clock_outside_gives_the_turn_back() -> None:
    clock = LockStepClock()
    clock.sleep(1.0)
    with clock.outside():
        clock.sleep(1.0)
    with capture_logs() as logs:
        clock.sleep(1.0)
    assert clock.now() == 3.0
    assert not logs


def test_a_thread_that_looks_up_now_and_then_loses_its_turn_too() -> None:
    clock, real = LockStepClock(), ScaledClock()
    slept = threading.Event()

    def sleep() -> None:
        clock.sleep(5.0)
        slept.set()

    with capture_logs() as logs:
        clock.sleep(0)
        clock.start(threading.Thread(target=sleep))
        end_s = real.now() + ENOUGH_S
        while not slept.is_set() and real.now() < end_s:
            real.sleep(0.2)  # once between two checks: a slow processor needs a fifth of _IDLE_S for each
    assert slept.is_set()
    assert [log["thread"] for log in logs] == [threading.current_thread().name]


def test_who_waits_on_another_clock_keeps_the_turn_of_the_first() -> None:
    first, second, real = LockStepClock(), LockStepClock(), ScaledClock()

    def hold_up() -> None:
        end_s = real.now() + 1.0  # longer than a watch is patient with one who waits for something
        while real.now() < end_s:
            sum(range(1000))

    first.sleep(0)
    first.start(threading.Thread(target=lambda: first.sleep(5.0)))
    with capture_logs() as logs:
        second.sleep(0)
        second.start(threading.Thread(target=hold_up))
        second.sleep(1.0)
    assert not logs
    assert (first.now(), second.now()) == (0.0, 1.0)


def test_a_thread_that_ended_with_the_turn_holds_up_nobody() -> None:
    clock = LockStepClock()
    stranger = threading.Thread(target=lambda: clock.sleep(1.0))
    stranger.start()
    stranger.join(ENOUGH_S)
    clock.sleep(2.0)
    assert clock.now() == 3.0


def test_an_interrupted_wait_leaves_the_clock_in_order() -> None:
    clock, waiter = LockStepClock(), new_waiter()
    import signal

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGUSR1, interrupt)
    try:
        threading.Timer(0.05, lambda: signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGUSR1)).start()
        with pytest.raises(KeyboardInterrupt):
            clock.wait(waiter, None)
    finally:
        signal.signal(signal.SIGUSR1, before)
    clock.wake(waiter)
    assert clock.wait(waiter, 1.0)
    clock.sleep(1.0)
    assert clock.now() == 1.0


def test_the_watch_ends_when_nobody_waits() -> None:
    clock = LockStepClock()
    run_together(clock, lambda: clock.sleep(1.0))
    watches = [thread for thread in threading.enumerate() if thread.name == "clock watchdog"]
    for watch in watches:
        watch.join(ENOUGH_S)
        assert not watch.is_alive()


def polls_until(time_s: float, deadline_s: float | None = None) -> int:
    """Return how often one thread asks another before the clock shows a time; each answer must come by a deadline."""
    clock, asked, answered = LockStepClock(), new_waiter(), new_waiter()
    polls, missed, is_over = 0, 0, False

    def answer() -> None:
        while not is_over:
            clock.wait(asked, None)
            clock.wake(answered)

    def poll() -> None:
        nonlocal polls, missed, is_over
        while clock.now() < time_s:
            polls += 1
            clock.wake(asked)
            missed += not clock.wait(answered, deadline_s)
        is_over = True
        clock.wake(asked)

    run_together(clock, answer, poll, *([lambda: clock.sleep(time_s)] if deadline_s is None else []))
    assert not missed
    return polls


def test_a_loop_that_polls_does_not_stop_time_and_repeats() -> None:
    assert polls_until(1.0) == polls_until(1.0) > 10


@pytest.mark.parametrize("deadline_s", [0.02, 10.0])
def test_a_loop_that_polls_never_misses_its_own_deadline(deadline_s: float) -> None:
    assert polls_until(1.0, deadline_s) == polls_until(1.0, deadline_s) > 10


def test_a_rate_makes_its_clock() -> None:
    assert isinstance(clock_of(MAX), LockStepClock)
    scaled = clock_of(3.0)
    assert isinstance(scaled, ScaledClock)
    assert scaled.of_real(2.0) == 6.0


class Reader:
    """Counts in steps of time, in its own thread or in that of another reader."""

    def __init__(
        self, clock: LockStepClock, name: str, period_s: float, steps: int, seen: list[tuple[str, float]]
    ) -> None:
        self.clock, self.name, self.period_s, self.steps, self.seen = clock, name, period_s, steps, seen
        self.due_s, self.threads = period_s, set[str]()
        self.waiter = new_waiter()

    def serve(self) -> float:
        """Count; return the time of the next count."""
        if self.steps and self.clock.now() >= self.due_s:
            self.threads.add(threading.current_thread().name)
            self.seen.append((self.name, self.clock.now()))
            self.steps -= 1
            self.due_s += self.period_s
            if not self.steps:
                self.clock.wake(self.waiter)
        return self.due_s if self.steps else math.inf

    def read(self, *, alone: bool) -> None:
        """Count until the steps are done."""
        while self.steps:
            is_woken = self.clock.wait(self.waiter, self.due_s - self.clock.now(), None if alone else self.serve)
            if not is_woken:
                self.serve()


def counted(*, alone: bool) -> tuple[list[tuple[str, float]], set[str]]:
    """Return what four readers have counted, and the threads in which they did."""
    clock, seen = LockStepClock(), list[tuple[str, float]]()
    readers = [
        Reader(clock, name, period_s, 50, seen) for name, period_s in zip("abcd", (0.25, 0.5, 0.5, 0.75), strict=True)
    ]
    run_together(clock, *(lambda reader=reader: reader.read(alone=alone) for reader in readers))
    return seen, {thread for reader in readers for thread in reader.threads}


def test_a_thread_that_waits_serves_others_in_the_same_order() -> None:
    alone, threads = counted(alone=True)
    assert len(threads) == 4
    together, threads = counted(alone=False)
    assert together == alone
    assert len(together) == 4 * 50
    assert len(threads) < 4


def test_a_served_thread_is_woken_when_it_is_asked_for() -> None:
    clock, seen = LockStepClock(), list[tuple[str, float]]()
    first, second = Reader(clock, "first", 0.5, 4, seen), Reader(clock, "second", 1.0, 1, seen)
    heard: list[tuple[bool, float]] = []

    def wait() -> None:
        clock.wait(second.waiter, 1.0, second.serve)  # until `second` has counted, in the thread of `first`
        heard.append((clock.wait(second.waiter, None, second.serve), clock.now()))

    def wake() -> None:
        clock.sleep(7.0)
        clock.wake(second.waiter)

    run_together(clock, lambda: first.read(alone=False), wait, wake)
    assert second.threads == {"thread 0"}
    assert heard == [(True, 7.0)]


def test_an_exception_of_a_served_thread_is_the_servers_and_the_other_waits_on() -> None:
    clock, heard = LockStepClock(), list[object]()

    def explode() -> float:
        raise ZeroDivisionError(threading.current_thread().name)

    def serve_others() -> None:
        with pytest.raises(ZeroDivisionError, match="thread 1"):
            clock.wait(new_waiter(), 5.0, lambda: math.inf)
        heard.append(clock.now())

    def wait() -> None:
        heard.append((clock.wait(new_waiter(), 1.0, explode), clock.now()))

    run_together(clock, wait, serve_others)
    assert heard == [1.0, (False, 1.0)]
