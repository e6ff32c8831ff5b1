"""An exception from another thread takes no lock with it: neither of a handler of `logging` nor of a block."""

from __future__ import annotations

import logging
import threading

import pytest
from typing_extensions import override

from eal_actors.kernel.log import get_logger
from eal_actors.kernel.unwinding import Uninterrupted, raise_in

WAIT_S = 30.0


class GivenUpError(BaseException):
    """Raised in the threads of these tests."""


class NotedLock:
    """A lock that shows when a thread is about to wait for it. Before Python 3.13, `logging` does not use `with`."""

    def __init__(self) -> None:
        self.asked = threading.Event()
        self._lock = threading.RLock()

    def acquire(self, blocking: bool = True, timeout: float = -1) -> bool:
        self.asked.set()
        return self._lock.acquire(blocking, timeout)

    def release(self) -> None:
        self._lock.release()

    def __enter__(self) -> None:
        self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()


class Handler(logging.Handler):
    """Keeps the messages."""

    lock: NotedLock  # type: ignore[assignment]

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    @override
    def createLock(self) -> None:
        self.lock = NotedLock()

    @override
    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())


@pytest.fixture
def handler() -> Handler:
    return Handler()


def test_a_thread_that_is_given_up_while_it_logs_leaves_the_handlers_lock(handler: Handler) -> None:
    """128 robots that were closed waited for ever for a lock that an abandoned thread had taken with it."""
    outcomes: list[type[BaseException] | None] = []

    def log() -> None:
        try:
            get_logger().error("one line")
        except GivenUpError as error:
            outcomes.append(type(error))
        else:
            outcomes.append(None)

    logger = logging.getLogger("eal_actors")
    thread = threading.Thread(target=log, daemon=True)
    logger.addHandler(handler)
    try:
        handler.acquire()
        handler.lock.asked.clear()
        try:
            thread.start()
            assert handler.lock.asked.wait(WAIT_S)
            raise_in(thread, GivenUpError)
        finally:
            handler.release()
        thread.join(WAIT_S)
    finally:
        logger.removeHandler(handler)
    assert outcomes == [GivenUpError]
    assert handler.lock.acquire(timeout=WAIT_S / 10), "nobody can log any more"
    handler.lock.release()
    assert handler.lines == ["one line"]


def test_an_exception_comes_at_the_end_of_the_outermost_block() -> None:
    inside, go_on = threading.Event(), threading.Event()
    reached: list[str] = []

    def run() -> None:
        try:
            with Uninterrupted():
                with Uninterrupted():
                    inside.set()
                    go_on.wait(WAIT_S)
                reached.append("the outer block")
            reached.append("too far")
        except GivenUpError:
            reached.append("given up")

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert inside.wait(WAIT_S)
    raise_in(thread, GivenUpError)
    go_on.set()
    thread.join(WAIT_S)
    assert reached == ["the outer block", "given up"]


def test_an_exception_comes_at_once_outside_a_block() -> None:
    started, never = threading.Event(), threading.Event()
    reached: list[str] = []

    def run() -> None:
        try:
            with Uninterrupted():
                pass
            started.set()
            while not never.wait(0.01):
                pass
        except GivenUpError:
            reached.append("given up")

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    assert started.wait(WAIT_S)
    raise_in(thread, GivenUpError)
    thread.join(WAIT_S)
    assert reached == ["given up"]


def test_a_thread_that_has_ended_is_left_alone() -> None:
    thread = threading.Thread(target=lambda: None)
    raise_in(thread, GivenUpError)  # not started
    thread.start()
    thread.join(WAIT_S)
    raise_in(thread, GivenUpError)
