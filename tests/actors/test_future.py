from __future__ import annotations

import asyncio
import concurrent.futures
import threading
from collections.abc import Callable

import pykka
import pytest
from structlog.testing import capture_logs

from eal_actors.actors.combine import as_completed, first, gather
from eal_actors.actors.future import Future
from eal_actors.actors.inbox import Inbox
from eal_actors.kernel.clock import SystemClock
from eal_actors.kernel.errors import CallCancelledError, CallError, DeadlineError, UnavailableError, WaitTimeoutError
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S


def done(value: int) -> Future[int]:
    future: Future[int] = Future()
    future.set(value)
    return future


def test_get_waits_for_a_result_from_another_thread() -> None:
    future: Future[int] = Future(deadline_s=SystemClock().now() + 1e9)
    setter = threading.Thread(target=lambda: future.set(42))
    setter.start()
    assert future.get(timeout=WAIT_S) == 42
    setter.join()


def test_the_first_outcome_stands() -> None:
    future = done(1)
    future.set(2)
    future.set_exception(UnavailableError("late"))
    assert future.get() == 1
    assert future.cancel() is False


def test_the_repr_tells_whether_it_is_pending_done_failed_or_cancelled() -> None:
    future: Future[int] = Future()
    assert repr(future) == "<Future future: pending>"
    future.cancel()
    assert repr(future) == "<Future future: cancelled>"
    assert repr(done(1)) == "<Future future: done>"
    failure: Future[int] = Future()
    failure.set_exception(UnavailableError("no"))
    assert repr(failure) == "<Future future: failed>"


def test_an_attribute_of_its_result_says_how_to_get_it() -> None:
    with pytest.raises(AttributeError, match="a future has no 'value'; its result, which `get` returns, may have"):
        _ = done(1).value  # type: ignore[attr-defined]
    assert not hasattr(done(1), "value")


def test_a_failure_is_raised_each_time_with_its_own_traceback() -> None:
    future: Future[int] = Future()
    future.set_exception(UnavailableError("no"))
    lengths = []
    for _ in range(3):
        with pytest.raises(UnavailableError) as caught:
            future.get()
        lengths.append(len(caught.traceback))
    assert len(set(lengths)) == 1


def test_get_fails_at_the_deadline_of_its_clock() -> None:
    clock = ManualClock()
    future: Future[int] = Future(clock, deadline_s=2.0)
    raised = threading.Event()

    def wait() -> None:
        with pytest.raises(DeadlineError):
            future.get()
        raised.set()

    waiter = threading.Thread(target=wait)
    waiter.start()
    clock.advance(1.9)
    assert not raised.wait(0.02)
    clock.advance(0.2)
    assert raised.wait(WAIT_S)
    waiter.join()
    future.set(1)
    assert isinstance(future.exception(), DeadlineError)


def test_a_short_wait_leaves_the_call_running() -> None:
    future: Future[int] = Future(SystemClock(), deadline_s=1e9)
    with pytest.raises(WaitTimeoutError, match="the call continues"):
        future.get(timeout=0.001)
    future.set(3)
    assert future.get() == 3


class CtrlCClock(ManualClock):
    """A clock on which every wait is interrupted."""

    def wait(self, waiter: threading.Lock, timeout_s: float | None, serve: Callable[[], float] | None = None) -> bool:
        raise KeyboardInterrupt


def test_ctrl_c_cancels_the_call_that_it_interrupts_a_wait_for() -> None:
    read, asked, *many = (Future[int](CtrlCClock(), deadline_s=10.0) for _ in range(4))
    for wait in (read.get, asked.exception, gather(many).get):
        with pytest.raises(KeyboardInterrupt):
            wait()
    assert all(future.cancelled() for future in (read, asked, *many))
    later = [Future[int](CtrlCClock()) for _ in range(2)]
    with pytest.raises(KeyboardInterrupt):
        next(as_completed(later))
    assert all(future.cancelled() for future in later)


def test_a_future_is_not_taken_for_its_value() -> None:
    with pytest.raises(TypeError, match="'Future' object is not iterable"):
        list(done(1))  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="'Future' object is not iterable"):
        gather(done(1))  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="a future is never equal to 1; its result, which `get` returns, may be"):
        assert done(1) == 1
    with pytest.raises(TypeError, match="a future is neither true nor false; its result"):
        assert done(0)
    future = done(1)
    assert {future: 1}[future] == 1
    assert future != done(1)


def test_callbacks_run_once_at_once_when_done_and_errors_do_not_spread() -> None:
    future: Future[int] = Future()
    seen: list[int] = []

    def broken(_: Future[int]) -> None:
        raise ValueError("my mistake")

    future.add_done_callback(broken)
    future.add_done_callback(lambda f: seen.append(f.get()))
    with capture_logs() as lines:
        future.set(5)
    future.add_done_callback(lambda f: seen.append(f.get() + 1))
    assert seen == [5, 6]
    assert "done-callback raised" in str(lines)


def test_a_callback_hears_of_the_deadline_from_the_timekeeper() -> None:
    clock = ManualClock()
    keeper = Inbox(clock)
    future: Future[int] = Future(clock, deadline_s=2.0, timekeeper=keeper)
    errors: list[BaseException | None] = []
    future.add_done_callback(lambda f: errors.append(f.exception()))
    clock.advance(2.0)
    timer = keeper.get().message
    timer.action()
    assert [type(error) for error in errors] == [DeadlineError]


def test_a_result_calls_the_alarm_off() -> None:
    keeper = Inbox(ManualClock())
    future: Future[int] = Future(keeper.clock, deadline_s=2.0, timekeeper=keeper)
    future.add_done_callback(lambda _: None)
    timer = keeper._timers.first()
    assert timer is not None
    future.set(1)
    assert timer.action is None


def test_gather_keeps_the_order_and_waits_for_all() -> None:
    parts: list[Future[int]] = [Future() for _ in range(3)]
    together = gather(parts)
    parts[2].set(2)
    parts[0].set(0)
    assert not together.done()
    parts[1].set(1)
    assert together.get() == [0, 1, 2]
    assert gather([]).get() == []


def test_gather_fails_when_all_are_done_or_returns_failures() -> None:
    failed: Future[int] = Future()
    pending: Future[int] = Future()
    together, listed = gather([failed, pending]), gather([failed, pending], return_exceptions=True)
    failed.set_exception(UnavailableError("no"))
    assert not together.done()
    pending.set(1)
    with pytest.raises(UnavailableError):
        together.get()
    assert [str(item) for item in listed.get()] == ["no", "1"]


def test_gather_expires_its_parts_at_the_latest_deadline() -> None:
    clock = ManualClock()
    parts: list[Future[int]] = [Future(clock, deadline_s=t) for t in (1.0, 2.0)]
    together = gather(parts, return_exceptions=True)
    clock.advance(2.0)
    assert all(isinstance(item, DeadlineError) for item in together.get())


def test_cancelling_a_gather_cancels_its_parts() -> None:
    parts: list[Future[int]] = [Future(), Future()]
    assert gather(parts).cancel()
    assert all(part.cancelled() for part in parts)


def test_first_takes_the_first_success_and_cancels_the_rest() -> None:
    parts: list[Future[int]] = [Future(), Future(), Future()]
    fastest = first(parts)
    parts[0].set_exception(UnavailableError("no"))
    assert not fastest.done()
    parts[2].set(7)
    assert fastest.get() == 7
    assert parts[1].cancelled()


def test_first_fails_when_all_have_failed_and_refuses_nothing() -> None:
    parts: list[Future[int]] = [Future(), Future()]
    fastest = first(parts)
    for part in parts:
        part.set_exception(UnavailableError("no"))
    with pytest.raises(UnavailableError):
        fastest.get()
    with pytest.raises(CallError):
        first([])


def test_as_completed_yields_in_the_order_of_completion() -> None:
    parts: list[Future[int]] = [Future() for _ in range(3)]
    iterator = as_completed(parts)
    parts[1].set(1)
    assert next(iterator) is parts[1]
    parts[2].set(2)
    parts[0].set(0)
    assert [part.get() for part in iterator] == [2, 0]


def test_conversion_to_the_standard_library_and_back_cancellation() -> None:
    future: Future[int] = Future()
    standard = future.to_concurrent()
    future.set(4)
    assert standard.result(WAIT_S) == 4
    failed: Future[int] = Future()
    mirror = failed.to_concurrent()
    failed.set_exception(UnavailableError("no"))
    with pytest.raises(UnavailableError):
        mirror.result(WAIT_S)
    cancelled: Future[int] = Future()
    assert cancelled.to_concurrent().cancel()
    assert cancelled.cancelled()
    with pytest.raises(concurrent.futures.CancelledError):
        cancelled.get()


def test_await_in_asyncio_and_cancelling_the_task_cancels_the_call() -> None:
    async def use() -> tuple[int, bool]:
        future: Future[int] = Future()
        threading.Thread(target=lambda: future.set(9)).start()
        value = await future
        hanging: Future[int] = Future()

        async def wait() -> int:
            return await hanging

        task = asyncio.create_task(wait())
        await asyncio.sleep(0)
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        return value, hanging.cancelled()

    assert asyncio.run(use()) == (9, True)


def test_pykkas_own_combinators_still_work() -> None:
    assert done(20).map(lambda value: value + 1).get() == 21
    assert done(1).join(done(2)).get() == [1, 2]
    assert isinstance(done(1), pykka.Future)


def test_cancelled_error_is_the_standard_one() -> None:
    assert issubclass(CallCancelledError, concurrent.futures.CancelledError)


# From threads that must not be held up.


def test_settling_wakes_and_relays_at_once_and_leaves_callbacks_for_later() -> None:
    parts: list[Future[int]] = [Future() for _ in range(2)]
    together = gather(parts)
    doubled = together.map(lambda values: 2 * sum(values))
    called: list[object] = []
    together.add_done_callback(called.append)
    left: list[Callable[[], None]] = []
    for number, part in enumerate(parts):
        part.settle(number, None, left.append)
    assert together.get() == [0, 1]
    assert (called, doubled.done()) == ([], False)
    for action in left:
        action()
    assert (called, doubled.get()) == ([together], 2)


def test_a_mapped_result_that_must_wait_for_other_callbacks_fails_at_the_deadline() -> None:
    clock = ManualClock()
    source: Future[int] = Future(clock, deadline_s=1.0)
    mapped = source.map(lambda value: 2 * value)
    source.settle(21, None, lambda _: None)  # the thread of callbacks does not come to it
    clock.advance(1.0)
    with pytest.raises(DeadlineError):
        mapped.get()


def test_the_first_success_gives_up_the_others_later() -> None:
    parts: list[Future[int]] = [Future() for _ in range(2)]
    quickest = first(parts)
    left: list[Callable[[], None]] = []
    parts[1].settle(7, None, left.append)
    assert quickest.get() == 7
    assert not parts[0].done()
    for action in left:
        action()
    assert parts[0].cancelled()


def test_an_outcome_is_settled_once() -> None:
    future: Future[int] = Future()
    seen: list[int] = []
    future.link(lambda done, _: seen.append(done.get()))
    future.settle(1, None, lambda action: action())
    future.settle(2, None, lambda action: action())
    future.link(lambda done, _: seen.append(done.get()))
    assert seen == [1, 1]
