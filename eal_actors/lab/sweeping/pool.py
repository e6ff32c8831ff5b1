"""Pool of worker processes for the runs of a sweep. A crashed worker loses its current run only."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Final, NamedTuple

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.lab.sweeping.worker import SweepTask, WorkerSettings, serve

RUN_LIMIT_S: Final = 3600.0
"""Time limit of one run, in real seconds."""


class FinishedTask(NamedTuple):
    """A run that a worker has finished or lost.

    Attributes:
        error: why it could not run; None if it ran, whatever its outcome.
        has_crashed: whether its process died, or was killed because it took too long.
    """

    task: SweepTask
    error: str | None
    has_crashed: bool


def run_all(tasks: Iterable[SweepTask], settings: WorkerSettings, jobs: int) -> Iterator[FinishedTask]:
    """Run tasks in worker processes; yield each as it ends.

    Args:
        tasks: the runs.
        settings: settings of all workers.
        jobs: number of processes, at least 1.

    Thread: blocks the caller. Closing the iterator early kills the processes.
    """
    waiting = iter(tasks)
    busy: list[_WorkerProcess] = []
    idle: list[_WorkerProcess] = []
    try:
        while True:
            while len(busy) < jobs and (task := next(waiting, None)) is not None:
                worker = idle.pop() if idle else _WorkerProcess(settings)
                busy.append(worker)
                worker.begin(task)
            if not busy:
                break
            _wait_for_any(busy)
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


def _wait_for_any(workers: list[_WorkerProcess]) -> None:
    """Wait until a worker answers, dies or exceeds its time limit."""
    end_s = min(worker.end_s for worker in workers)
    wait([handle for worker in workers for handle in worker.wait_handles], max(0.0, end_s - REAL_TIME.now()))


class _WorkerProcess:
    """A worker process with its current run."""

    def __init__(self, settings: WorkerSettings) -> None:
        context = get_context("spawn")  # a fork would copy locks that threads of this process hold
        self._pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(target=serve, args=(theirs, settings), name="eal sweep")
        self._process.start()
        theirs.close()
        self._task: SweepTask | None = None
        self.end_s = 0.0

    @property
    def wait_handles(self) -> tuple[Connection, int]:
        """Handles of which one becomes ready when the worker answers or dies."""
        return self._pipe, self._process.sentinel

    @property
    def is_over(self) -> bool:
        """Whether its run has ended, crashed or exceeded the time limit."""
        return self._pipe.poll() or not self._process.is_alive() or self.end_s <= REAL_TIME.now()

    def begin(self, task: SweepTask) -> None:
        """Start a run."""
        self._task, self.end_s = task, REAL_TIME.now() + RUN_LIMIT_S
        with contextlib.suppress(OSError):  # it has died; `answer` reports that
            self._pipe.send(task)

    def answer(self) -> FinishedTask:
        """Return the result of its run; kill a process that has no answer."""
        task, self._task = self._task, None
        if task is None:
            raise AssertionError("the worker has no run")
        with contextlib.suppress(EOFError, OSError):
            if self._pipe.poll():
                return FinishedTask(task, self._pipe.recv(), has_crashed=False)
        is_late = self.end_s <= REAL_TIME.now()
        if not is_late:
            self._process.join(_GRACE_S)
        code = self._process.exitcode
        self.kill()
        reason = (
            f"took more than {RUN_LIMIT_S:g} s of real time" if is_late else f"its process died with exit code {code}"
        )
        return FinishedTask(task, reason, has_crashed=True)

    def dismiss(self) -> None:
        """End the process in order: no further runs."""
        self._pipe.close()
        self._process.join(_GRACE_S)
        self.kill()

    def kill(self) -> None:
        """Kill the process, which is safe: everything that it moves is simulated."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


_GRACE_S: Final = 5.0  # real seconds that a process has to end
