"""Pool of worker processes for many simulated runs. A crashed worker loses its current task only."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import EALError, error_text
from eal_actors.kernel.log import configure_logging

T = TypeVar("T")
R = TypeVar("R")

RUN_LIMIT_S: Final = 3600.0
"""Time limit of one task, in real seconds."""


@dataclass(frozen=True, slots=True)
class FinishedTask(Generic[T, R]):
    """A finished or lost task; it has crashed if its process died, or was killed because it took too long."""

    task: T
    result: R | None
    error: str | None
    has_crashed: bool = False


def run_all(
    tasks: Iterable[T], perform: Callable[[T], R], log: Path, jobs: int
) -> Generator[FinishedTask[T, R], None, None]:
    """Perform tasks in worker processes; yield each as it ends.

    The tasks are pickled. Each of the processes, at least one, has a copy of `perform`; `log` is theirs.

    Thread: blocks the caller. Closing the iterator early kills the processes.
    """
    waiting = iter(tasks)
    busy: list[_WorkerProcess[T, R]] = []
    idle: list[_WorkerProcess[T, R]] = []
    try:
        while True:
            while len(busy) < jobs and (task := next(waiting, None)) is not None:
                worker = idle.pop() if idle else _WorkerProcess(perform, log)
                busy.append(worker)
                worker.begin(task)
            if not busy:
                break
            end_s = min(worker.end_s for worker in busy)
            wait([handle for worker in busy for handle in worker.wait_handles], max(0.0, end_s - REAL_TIME.now()))
            for worker in [worker for worker in busy if worker.is_over]:
                busy.remove(worker)
                answer = worker.answer()
                if not answer.has_crashed:
                    idle.append(worker)
                yield answer
        for worker in idle:
            worker.dismiss()
    finally:
        for worker in (*busy, *idle):
            worker.kill()


class _WorkerProcess(Generic[T, R]):
    """A worker process with its current task."""

    def __init__(self, perform: Callable[[T], R], log: Path) -> None:
        context = get_context("spawn")  # a fork would copy locks that threads of this process hold
        self._pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(target=_serve, args=(theirs, perform, log), name="eal worker")
        self._process.start()
        theirs.close()
        self._task: T | None = None
        self.end_s = 0.0

    @property
    def wait_handles(self) -> tuple[Connection, int]:
        """Handles of which one becomes ready when the worker answers or dies."""
        return self._pipe, self._process.sentinel

    @property
    def is_over(self) -> bool:
        """Whether its task has ended, crashed or exceeded the time limit."""
        return self._pipe.poll() or not self._process.is_alive() or self.end_s <= REAL_TIME.now()

    def begin(self, task: T) -> None:
        self._task, self.end_s = task, REAL_TIME.now() + RUN_LIMIT_S
        with contextlib.suppress(OSError):  # it has died; `answer` reports that
            self._pipe.send(task)

    def answer(self) -> FinishedTask[T, R]:
        """Return the result of its task; kill a process that has no answer."""
        task, self._task = self._task, None
        if task is None:
            raise AssertionError("the worker has no task")
        with contextlib.suppress(EOFError, OSError):
            if self._pipe.poll():
                result, error = self._pipe.recv()
                return FinishedTask(task, result, error)
        is_late = self.end_s <= REAL_TIME.now()
        if not is_late:
            self._process.join(_GRACE_S)
        code = self._process.exitcode
        self.kill()
        reason = (
            f"took more than {RUN_LIMIT_S:g} s of real time" if is_late else f"its process died with exit code {code}"
        )
        return FinishedTask(task, None, reason, has_crashed=True)

    def dismiss(self) -> None:
        """End the process in order: no further tasks."""
        self._pipe.close()
        self._process.join(_GRACE_S)
        self.kill()

    def kill(self) -> None:
        """Kill the process, which is safe: everything that it moves is simulated."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


_GRACE_S: Final = 5.0  # real seconds that a process has to end


def _serve(tasks: Connection, perform: Callable[[Any], Any], log: Path) -> None:
    """Perform tasks until the connection closes; the answer to each is its result, and the reason if it failed.

    Thread: the main thread of a worker process, which ends with its parent.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent receives it too, and kills this process
    _die_with_parent()
    with log.open("a", encoding="utf-8", buffering=1) as stream:
        os.dup2(stream.fileno(), 2)
        sys.stderr = stream
        configure_logging("human", "warning")
        while True:
            try:
                task = tasks.recv()
            except EOFError:
                return
            answer: tuple[Any, str | None]
            try:
                answer = perform(task), None
            except Exception as error:  # noqa: BLE001  # the parent reports it
                answer = None, str(error) if isinstance(error, EALError) else error_text(error)
            tasks.send(answer)


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, name="parent watch", daemon=True).start()
