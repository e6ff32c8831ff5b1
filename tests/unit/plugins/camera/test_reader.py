"""The reading thread, on a source that a test cranks."""

from __future__ import annotations

import os
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import cast

import pytest
import structlog

from eal_actors.kernel.errors import ArgumentError, NotReadyError, UnavailableError
from plugins.camera import reader as module
from plugins.camera.capture import real_s
from plugins.camera.files import VideoFile
from plugins.camera.reader import Picture, ReaderOptions, SourceReader
from tests.manual_clock import ManualClock
from tests.unit.plugins.camera.rig import PATIENCE_S, CrankedCapture, number_in, picture, run, wait_until_ready

TERMS = ReaderOptions("bench", PATIENCE_S)


class CallClock(ManualClock):
    """Tells when a reader has noted a call: it asks for its time-out then."""

    def __init__(self) -> None:
        super().__init__(7.0)
        self.called = threading.Semaphore(0)

    def of_real(self, duration_s: float) -> float:
        self.called.release()
        return super().of_real(duration_s)


class Bench:
    """A reader, its cranked source, and callers in threads of their own."""

    def __init__(self, terms: ReaderOptions = TERMS) -> None:
        self.clock = CallClock()
        self.source = CrankedCapture()
        self.absent: OSError | None = None
        self.reader = SourceReader(self._open, terms, self.clock)
        self._callers = ThreadPoolExecutor(16)

    def _open(self) -> CrankedCapture:
        if self.absent is not None:
            raise self.absent
        return self.source

    def __enter__(self) -> Bench:
        self.reader.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.source.given.put(EOFError("the test is over"))
        self.reader.close()
        self._callers.shutdown()

    def call(self) -> Future[Picture]:
        """Have a caller ask for a picture; return when it has."""
        asked = self._callers.submit(lambda: cast("Picture", run(self.reader.newer())))
        assert self.clock.called.acquire(timeout=PATIENCE_S)
        return asked

    def wish(self, wishes: dict[str, float]) -> Future[None]:
        """Have a caller ask something of the source; return when it has."""
        asked = self._callers.submit(lambda: cast("None", run(self.reader.adjust(wishes))))
        assert self.clock.called.acquire(timeout=PATIENCE_S)
        return asked

    def await_reading(self) -> None:
        """Wait until the reader has begun to read."""
        assert self.source.is_read.acquire(timeout=PATIENCE_S)

    def give(self, number: int) -> None:
        """Deliver a picture, and wait until the reader reads on."""
        self.source.given.put(picture(number))
        self.await_reading()


def shown(asked: Future[Picture]) -> int:
    return number_in(asked.result(PATIENCE_S).image)


def test_a_picture_was_begun_after_the_call() -> None:
    with Bench() as bench:
        bench.await_reading()
        bench.give(1)  # the newest when the call comes; 2 is being read
        asked = bench.call()
        bench.give(2)
        assert not asked.done()
        bench.give(3)
        assert shown(asked) == 3


def test_callers_of_one_moment_share_a_picture() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = [bench.call() for _ in range(12)]
        bench.give(1)
        bench.give(2)
        assert {shown(one) for one in asked} == {2}
        assert len({id(one.result().image) for one in asked}) == 1  # no copy is made for each


def test_a_picture_carries_the_time_of_the_fleets_clock() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = bench.call()
        bench.give(1)
        bench.clock.advance(5.0)
        bench.give(2)
        assert asked.result(PATIENCE_S).stamp_s == 12.0


def test_a_source_that_is_absent_is_tried_again_until_it_comes() -> None:
    bench = Bench()
    bench.absent = FileNotFoundError("not plugged in")
    with bench:
        with pytest.raises(NotReadyError, match=r"bench: not plugged in; next try in 0\.\d s"):
            run(bench.reader.newer())
        bench.absent = None
        bench.await_reading()
        bench.give(1)
        wait_until_ready(bench.reader)
        asked = bench.call()
        bench.give(2)
        bench.give(3)
        assert shown(asked) == 3


def test_tries_come_less_and_less_often_up_to_every_five_seconds() -> None:
    bench, delays = Bench(), []
    bench.absent = OSError("gone")
    sleep = bench.reader._sleep

    def note(duration_s: float, unless: object) -> None:
        delays.append(duration_s)
        if len(delays) == 7:
            bench.reader._is_stopping = True
        sleep(0.0, lambda: False)

    bench.reader._sleep = note  # type: ignore[method-assign]  # the waits are what is looked at
    with bench:
        bench.reader._thread.join(PATIENCE_S)
    assert delays == [0.2, 0.4, 0.8, 1.6, 3.2, 5.0, 5.0]


def test_a_caller_who_waits_is_told_at_once_that_the_source_is_lost() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = bench.call()
        bench.source.given.put(OSError("unplugged"))
        with pytest.raises(NotReadyError, match="bench: unplugged; next try in"):
            asked.result(PATIENCE_S)
        assert bench.source.released.acquire(timeout=PATIENCE_S)
        bench.await_reading()  # it is opened anew
        bench.give(1)
        assert bench.reader.why_not_ready() is None


def test_a_backend_that_breaks_in_another_way_is_tried_again_too() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = bench.call()
        bench.source.given.put(MemoryError("too large"))
        with pytest.raises(NotReadyError, match="bench: MemoryError: too large; next try in"):
            asked.result(PATIENCE_S)
        bench.await_reading()


def test_the_end_is_the_end() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = bench.call()
        bench.source.given.put(EOFError("it has ended"))
        with pytest.raises(NotReadyError, match=r"^bench: it has ended$"):
            asked.result(PATIENCE_S)
        bench.reader._thread.join(PATIENCE_S)
        assert not bench.reader._thread.is_alive()


class RealTime:
    """Stands in for the passing of real time in the reader's judgement."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 100.0
        monkeypatch.setattr(module, "real_s", lambda: self.now_s)


def test_a_source_that_falls_silent_is_frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    time = RealTime(monkeypatch)
    with Bench(ReaderOptions("bench", 2.0)) as bench:
        bench.await_reading()
        bench.give(1)
        time.now_s += 2.0
        assert bench.reader.why_not_ready() is None
        time.now_s += 0.5
        assert bench.reader.why_not_ready() == "bench is frozen: no picture for 2.5 s"
        with pytest.raises(NotReadyError, match="frozen"):
            run(bench.reader.newer())
        bench.give(2)
        assert bench.reader.why_not_ready() is None


def test_a_caller_learns_that_the_source_falls_silent_while_it_waits() -> None:
    with Bench(ReaderOptions("bench", 0.05)) as bench:
        bench.await_reading()
        with pytest.raises(NotReadyError, match=r"bench is frozen: no picture for \d+\.\d s"):
            run(bench.reader.newer())


def test_a_source_that_shows_the_same_for_ever_is_frozen(monkeypatch: pytest.MonkeyPatch) -> None:
    time = RealTime(monkeypatch)
    with Bench(ReaderOptions("bench", PATIENCE_S, frozen_after_s=5.0)) as bench:
        bench.await_reading()
        for number in (6, 7, 7, 7):
            bench.give(number)
            assert bench.reader.why_not_ready() is None
            time.now_s += 2.0
        bench.give(7)
        assert bench.reader.why_not_ready() == "bench is frozen: an identical picture for 6.0 s"
        with pytest.raises(NotReadyError, match="frozen"):
            run(bench.reader.newer())
        bench.give(8)
        assert bench.reader.why_not_ready() is None


def test_what_was_taken_before_may_show_the_same_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    time = RealTime(monkeypatch)
    with Bench(ReaderOptions("bench", PATIENCE_S, frozen_after_s=None)) as bench:
        bench.await_reading()
        for _ in range(5):
            bench.give(7)
            time.now_s += 50.0
        assert bench.reader.why_not_ready() is None


def test_a_single_bit_makes_another_picture() -> None:
    one, other = picture(3), picture(3)
    assert module.is_same(one, other)
    other[47, 63, 2] ^= 1
    assert not module.is_same(one, other)
    assert not module.is_same(one, one[:40])


def test_a_fast_clock_ends_the_wait_of_a_caller_but_not_of_the_source() -> None:
    bench = Bench(ReaderOptions("bench", PATIENCE_S))
    bench.clock.of_real = lambda duration_s: duration_s * 1e5  # type: ignore[method-assign]  # as its rate were
    with bench:
        bench.await_reading()
        with pytest.raises(
            UnavailableError, match="bench has delivered no newer picture within 60 s of the fleet's clock"
        ):
            run(bench.reader.newer())
        assert bench.reader.why_not_ready() is None


def test_wishes_are_asked_at_each_opening() -> None:
    with Bench(ReaderOptions("bench", PATIENCE_S, wishes={"width": 320})) as bench:
        bench.await_reading()
        wish = bench.wish({"fps": 15.0})
        bench.give(1)
        assert wish.result(PATIENCE_S) is None
        assert run(bench.reader.mode())["fps"] == 15.0  # at once, before a picture comes
        bench.source.given.put(OSError("unplugged"))
        bench.await_reading()
        assert bench.source.adjusted == [{"width": 320}, {"fps": 15.0}, {"width": 320, "fps": 15.0}]


def test_a_wish_that_nobody_waits_for_is_withdrawn() -> None:
    with Bench() as bench:
        bench.await_reading()
        wish = bench.reader.adjust({"fps": 15.0})
        next(wish)
        wish.close()
        bench.give(1)
        assert bench.source.adjusted == [{}]


def test_a_step_of_waiting_is_short() -> None:
    with Bench() as bench:
        bench.await_reading()
        waiting = bench.reader.newer()
        begun_s = real_s()
        pauses_s = [next(waiting) for _ in range(5)]
        assert real_s() - begun_s > 0.05  # of real time, so that a clock in lock step does not jump over the camera
        assert sum(pauses_s) < 0.01


def test_what_is_refused_is_told_and_not_asked_again() -> None:
    with Bench() as bench:
        bench.await_reading()
        bench.source.refuses = ["fps: no"]
        wish = bench.wish({"fps": 15.0})
        bench.give(1)
        with pytest.raises(ArgumentError, match="bench: fps: no"):
            wish.result(PATIENCE_S)
        bench.source.given.put(OSError("unplugged"))
        bench.await_reading()
        assert bench.source.adjusted == [{}, {"fps": 15.0}, {}]


def test_what_is_refused_at_the_opening_is_logged() -> None:
    bench = Bench(ReaderOptions("bench", PATIENCE_S, wishes={"width": 1000}, place={"robot": "rob"}))
    bench.source.refuses = ["width: the camera has no 1000 px"]
    with structlog.testing.capture_logs() as lines, bench:
        bench.await_reading()
    assert {"source": "bench", "refused": bench.source.refuses, "log_level": "warning"}.items() <= lines[0].items()


def test_a_picture_too_large_for_its_description_is_no_picture() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = bench.call()
        bench.source.given.put(picture(1)[:8])
        with pytest.raises(NotReadyError, match="its pictures have 64 x 8 px, outside 16 to 4096 px"):
            asked.result(PATIENCE_S)
        bench.await_reading()


def test_closing_ends_the_wait_of_a_caller() -> None:
    with Bench() as bench:
        bench.await_reading()
        asked = bench.call()
        bench.source.given.put(picture(1))
        threading.Thread(target=bench.reader.close).start()
        bench.source.given.put(EOFError("the test is over"))
        with pytest.raises(NotReadyError, match=r"bench is closed|bench: the test is over"):
            asked.result(PATIENCE_S)


def test_a_source_that_hangs_is_told_and_abandoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = tmp_path / "hangs.avi"
    os.mkfifo(pipe)  # who opens it waits until somebody writes
    monkeypatch.setattr(module, "_JOIN_S", 0.05)
    reader = SourceReader(lambda: VideoFile(pipe, loop=False), ReaderOptions("hangs.avi", 0.05), ManualClock())
    reader.start()
    with pytest.raises(NotReadyError, match=r"hangs.avi has neither opened nor failed for \d+\.\d s"):
        run(reader.newer())
    with structlog.testing.capture_logs() as lines:
        reader.close()
    assert [(line["log_level"], line["source"]) for line in lines] == [("error", "hangs.avi")]
    assert "abandoned" in lines[0]["event"]
    pipe.open("wb").close()  # it answers at last, and the thread ends
    reader._thread.join(PATIENCE_S)
    assert not reader._thread.is_alive()
