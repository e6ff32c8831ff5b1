from __future__ import annotations

import signal

import pytest

from eal_actors.actors.future import Future
from eal_actors.kernel.clock import ScaledClock
from eal_actors.kernel.errors import DeadlineError
from eal_actors.scenario.engine.loop import Coroutine, EventLoop


def no_error(error: Exception) -> None:
    raise AssertionError from error


@pytest.fixture
def loop() -> EventLoop:
    return EventLoop(ScaledClock(1000.0), no_error)


def test_branches_take_turns_at_their_futures(loop: EventLoop) -> None:
    seen: list[str] = []
    over: Future[None] = Future()
    left = [2]

    def count(error: BaseException | None) -> None:
        assert error is None
        left[0] -= 1
        if not left[0]:
            over.set()

    def branch(name: str, *waits_s: float) -> Coroutine:
        for wait_s in waits_s:
            yield loop.sleep(wait_s)
            seen.append(f"{name}{wait_s:g}")

    def main() -> Coroutine:
        loop.spawn(branch("a", 10, 30), count)
        loop.spawn(branch("b", 20, 40), count)
        yield over

    loop.run(main())

    assert seen == ["a10", "b20", "a30", "b40"]


def test_a_future_that_is_done_does_not_wait(loop: EventLoop) -> None:
    def main() -> Coroutine:
        for number in range(10_000):  # and does not nest
            future: Future[int] = Future()
            future.set(number)
            yield future
            assert future.get() == number

    loop.run(main())


def test_what_a_branch_raises_comes_out(loop: EventLoop) -> None:
    def main() -> Coroutine:
        yield loop.sleep(1)
        raise ValueError("broken")

    with pytest.raises(ValueError, match="broken"):
        loop.run(main())


def test_deadlines_ring_in_the_loop(loop: EventLoop) -> None:
    future: Future[None] = Future(loop.clock, loop.clock.now() + 5.0)

    def main() -> Coroutine:
        yield future

    loop.run(main())

    assert isinstance(future.exception(), DeadlineError)


def test_alarms_that_are_called_off_are_forgotten(loop: EventLoop) -> None:
    for _ in range(5000):
        loop.call_at(1e9, lambda: None).cancel()

    assert len(loop._timers) < 3000


def test_a_signal_handler_may_post(loop: EventLoop) -> None:
    over: Future[None] = Future()
    before = signal.signal(signal.SIGUSR1, lambda *_: loop.post(over.set))

    def main() -> Coroutine:
        signal.raise_signal(signal.SIGUSR1)
        yield over

    try:
        loop.run(main())
    finally:
        signal.signal(signal.SIGUSR1, before)

    assert over.done()


def test_an_action_that_raises_is_reported_and_ends_nothing() -> None:
    errors: list[Exception] = []
    loop = EventLoop(ScaledClock(1000.0), errors.append)

    def fail() -> None:
        raise OSError("full")

    def main() -> Coroutine:
        loop.post(fail)
        loop.call_at(loop.clock.now() + 1, fail)
        yield loop.sleep(2)

    loop.run(main())

    assert [str(error) for error in errors] == ["full", "full"]


def test_a_deadline_of_another_clock_does_not_ring_in_the_loop(loop: EventLoop) -> None:
    future: Future[int] = Future(ScaledClock(), 5.0)

    def main() -> Coroutine:
        loop.call_at(loop.clock.now() + 100, lambda: future.set(1))
        yield future

    loop.run(main())

    assert future.get() == 1


def test_a_sleep_that_is_cut_short_is_forgotten(loop: EventLoop) -> None:
    for _ in range(5000):
        loop.sleep(1e9).cancel()

    assert len(loop._timers) < 3000
