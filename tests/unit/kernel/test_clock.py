from __future__ import annotations

import signal
import threading

import pytest

from eal_actors.kernel.clock import REAL_TIME, Clock, ScaledClock, SystemClock, new_waiter, wall_time
from tests.manual_clock import ManualClock


@pytest.mark.parametrize("clock", [SystemClock(), ScaledClock(100), ManualClock()], ids=["system", "scaled", "manual"])
def test_a_released_waiter_wakes_and_is_held_again(clock: Clock) -> None:
    waiter = new_waiter()
    clock.wake(waiter)
    clock.wake(waiter)  # harmless
    assert clock.wait(waiter, 5.0)
    assert waiter.locked()
    assert not clock.wait(waiter, 0.0)


def test_a_scaled_clock_runs_faster_by_its_rate() -> None:
    clock = ScaledClock(1000)
    real_s, scaled_s = REAL_TIME.now(), clock.now()
    clock.sleep(2.0)
    assert clock.now() - scaled_s >= 2.0
    assert REAL_TIME.now() - real_s < 1.0


def test_a_scaled_wait_ends_by_itself() -> None:
    assert not ScaledClock(1000).wait(new_waiter(), 1.0)


@pytest.mark.parametrize("rate", [0, -1, float("nan")])
def test_a_rate_that_is_none_is_refused(rate: float) -> None:
    with pytest.raises(ValueError, match="over 0"):
        ScaledClock(rate)


def test_a_manual_clock_wakes_each_wait_at_its_time() -> None:
    clock = ManualClock(start_s=10.0)
    ended: list[float] = []
    done = {2.0: threading.Event(), 1.0: threading.Event()}

    def wait(duration_s: float) -> None:
        clock.sleep(duration_s)
        ended.append(duration_s)
        done[duration_s].set()

    threads = [threading.Thread(target=wait, args=(duration_s,)) for duration_s in done]
    for thread in threads:
        thread.start()
    while len(clock._waits) < 2:
        threads[0].join(0.001)
    clock.advance(1.0)
    assert done[1.0].wait(5)
    assert ended == [1.0]
    clock.advance(1.0)
    assert done[2.0].wait(5)
    assert clock.now() == 12.0
    for thread in threads:
        thread.join()


def test_wall_time_is_in_utc() -> None:
    offset = wall_time().utcoffset()
    assert offset is not None
    assert offset.total_seconds() == 0


def test_a_signal_that_does_not_wake_the_main_thread_is_handled_all_the_same() -> None:
    waiter = new_waiter()
    before = signal.signal(signal.SIGUSR1, lambda *_: REAL_TIME.wake(waiter))
    elsewhere = threading.Thread(target=lambda: signal.pthread_kill(threading.get_ident(), signal.SIGUSR1))
    try:
        elsewhere.start()
        assert REAL_TIME.wait(waiter, 30.0)
    finally:
        elsewhere.join()
        signal.signal(signal.SIGUSR1, before)
