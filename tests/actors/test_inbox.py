from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from eal_actors.actors.inbox import Inbox
from eal_actors.kernel.clock import SystemClock, Timer
from eal_actors.kernel.errors import BusyError, UnavailableError
from tests.manual_clock import ManualClock
from tests.robots import WAIT_S


@dataclass(frozen=True)
class Letter:
    message: Any
    reply_to: Any = None


def drain(inbox: Inbox) -> list[Any]:
    return [inbox.get().message for _ in range(len(inbox))]


def test_urgent_goes_first_and_each_lane_is_first_in_first_out() -> None:
    inbox = Inbox(SystemClock())
    for text in ("a", "b"):
        inbox.put(Letter(text))
    for text in ("stop", "status"):
        inbox.put_urgent(Letter(text))
    assert drain(inbox) == ["stop", "status", "a", "b"]


def test_a_full_lane_refuses_at_once() -> None:
    inbox = Inbox(SystemClock(), capacity=2)
    inbox.put(Letter(1))
    inbox.put(Letter(2))
    with pytest.raises(BusyError, match="2 calls wait"):
        inbox.put(Letter(3))
    assert drain(inbox) == [1, 2]


def test_a_full_urgent_lane_refuses_status_but_never_a_stop() -> None:
    inbox = Inbox(SystemClock(), capacity=1)
    inbox.put_urgent(Letter("status"))
    with pytest.raises(BusyError):
        inbox.put_urgent(Letter("status again"))
    inbox.put_urgent(Letter("stop"), bounded=False)
    assert drain(inbox) == ["status", "stop"]


def test_the_actor_s_own_actions_take_no_call_s_place() -> None:
    inbox = Inbox(SystemClock(), capacity=2)
    for _ in range(5):
        inbox.call_soon(lambda: None)  # such as giving up what was cancelled
    inbox.put_urgent(Letter("status"))
    inbox.put_urgent(Letter("status again"))
    with pytest.raises(BusyError, match="2 urgent calls wait"):
        inbox.put_urgent(Letter("one more"))


def test_a_stop_takes_out_what_waited_before_it_and_nothing_that_comes_after() -> None:
    inbox = Inbox(SystemClock())
    for text in ("go", "read", "go again"):
        inbox.put(Letter(text))
    dropped = inbox.put_urgent(Letter("stop"), drop=lambda letter: str(letter.message).startswith("go"))
    inbox.put(Letter("go later"))
    assert [letter.message for letter in dropped] == ["go", "go again"]
    assert drain(inbox) == ["stop", "read", "go later"]


def test_timers_ring_in_the_order_of_their_times_between_urgent_and_normal() -> None:
    clock = ManualClock()
    inbox = Inbox(clock)
    timers = [inbox.call_at(time_s, lambda: None) for time_s in (3.0, 1.0, 2.0)]
    inbox.put(Letter("normal"))
    inbox.put_urgent(Letter("urgent"))
    clock.advance(2.5)
    assert inbox.get().message == "urgent"
    assert inbox.get() is timers[1]
    assert inbox.get() is timers[2]
    assert inbox.get().message == "normal"


def test_a_timer_that_is_always_due_does_not_keep_calls_out() -> None:
    inbox = Inbox(ManualClock())
    inbox.call_later(0.0, lambda: None)
    inbox.put(Letter("call"))
    assert isinstance(inbox.get(), Timer)
    inbox.call_later(0.0, lambda: None)
    assert inbox.get().message == "call"


def test_a_waiting_reader_is_woken_by_a_timer_that_comes_before_the_one_it_waits_for() -> None:
    clock = ManualClock()
    inbox = Inbox(clock)
    inbox.call_at(100.0, lambda: None)
    got: list[Any] = []
    reader = threading.Thread(target=lambda: got.append(inbox.get()))
    reader.start()
    early = inbox.call_at(1.0, lambda: None)
    while reader.is_alive():
        clock.advance(0.5)
        reader.join(0.01)
        assert clock.now() < WAIT_S * 100
    assert got == [early]


def test_cancelled_timers_do_not_ring_and_do_not_pile_up() -> None:
    clock = ManualClock()
    inbox = Inbox(clock)
    for _ in range(10_000):
        inbox.call_at(5.0, lambda: None).cancel()
    assert len(inbox._timers) < 3000
    inbox.put(Letter("only"))
    clock.advance(10.0)
    assert inbox.get().message == "only"


def test_a_closed_inbox_returns_what_waited_and_refuses_with_its_reason() -> None:
    inbox = Inbox(SystemClock())
    inbox.put(Letter("normal"))
    inbox.put_urgent(Letter("urgent"))
    assert [letter.message for letter in inbox.close(UnavailableError("gone"))] == ["urgent", "normal"]
    with pytest.raises(UnavailableError, match="gone"):
        inbox.put(Letter("late"))


def test_many_writers_lose_nothing() -> None:
    inbox = Inbox(SystemClock(), capacity=100_000)
    got: list[tuple[int, int]] = []

    def write(writer: int) -> None:
        for number in range(2000):
            inbox.put(Letter((writer, number)))

    def read() -> None:
        got.extend(inbox.get().message for _ in range(8000))

    writers = [threading.Thread(target=write, args=(w,)) for w in range(4)]
    reader = threading.Thread(target=read)
    for thread in [reader, *writers]:
        thread.start()
    for thread in [*writers, reader]:
        thread.join(WAIT_S)
    for w in range(4):
        assert [n for writer, n in got if writer == w] == list(range(2000))


@given(st.lists(st.tuples(st.sampled_from(["put", "urgent", "timer", "get"]), st.integers(0, 9)), max_size=60))
def test_any_order_of_use_agrees_with_a_plain_model(steps: list[tuple[str, int]]) -> None:
    clock = ManualClock()
    inbox = Inbox(clock, capacity=5)
    urgent: list[int] = []
    normal: list[tuple[int, int]] = []
    timers: list[tuple[float, int]] = []
    for number, (step, value) in enumerate(steps):
        if step == "put":
            if len(normal) < 5:
                inbox.put(Letter(value))
                normal.append((number, value))
            else:
                with pytest.raises(BusyError):
                    inbox.put(Letter(value))
        elif step == "urgent":
            inbox.put_urgent(Letter(value), bounded=False)
            urgent.append(value)
        elif step == "timer":
            timers.append((inbox.call_later(value, lambda: None).time_s, number))
        elif urgent or normal or any(time_s <= clock.now() for time_s, _ in timers):
            got = inbox.get()
            due = sorted(timer for timer in timers if timer[0] <= clock.now())
            if urgent:
                assert got.message == urgent.pop(0)
            elif due and (not normal or due[0][1] < normal[0][0]):
                assert isinstance(got, Timer)
                assert got.time_s == due[0][0]
                timers.remove(due[0])
            else:
                assert got.message == normal.pop(0)[1]
        clock.advance(0.5)
