"""Several processes at work on runs. One that dies costs the run that it was at, and nothing else."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Final, NamedTuple

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.lab.sweeping.worker import Task, Workplace, serve

RUN_LIMIT_S: Final = 3600.0
"""Real seconds that one run may take."""


class Answer(NamedTuple):
    """A run that is over.

    Attributes:
        task: the run.
        error: why it could not be carried out; None if it was, with whatever outcome.
        has_crashed: whether its process died, or took too long and was ended.
    """

    task: Task
    error: str | None
    has_crashed: bool


def run_all(tasks: Iterable[Task], workplace: Workplace, jobs: int) -> Iterator[Answer]:
    """Carry out runs in processes of their own; yield each when it is over, in the order in which they end.

    Args:
        tasks: the runs.
        workplace: what is the same for all.
        jobs: how many processes, at least 1.

    Thread: blocks the caller. Leaving the iteration early ends the processes at once.
    """
    waiting = iter(tasks)
    busy: list[_Worker] = []
    idle: list[_Worker] = []
    try:
        while True:
            while len(busy) < jobs and (task := next(waiting, None)) is not None:
                worker = idle.pop() if idle else _Worker(workplace)
                busy.append(worker)
                worker.begin(task)
            if not busy:
                break
            _await(busy)
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


def _await(workers: list[_Worker]) -> None:
    """Wait until one of them has something to say, or is late."""
    end_s = min(worker.end_s for worker in workers)
    wait([part for worker in workers for part in worker.signs], max(0.0, end_s - REAL_TIME.now()))


class _Worker:
    """A process, and the run that it is at."""

    def __init__(self, workplace: Workplace) -> None:
        context = get_context("spawn")  # a fork would take over locks of threads that it does not have
        self._pipe, theirs = context.Pipe()
        self._process: SpawnProcess = context.Process(target=serve, args=(theirs, workplace), name="eal sweep")
        self._process.start()
        theirs.close()
        self._task: Task | None = None
        self.end_s = 0.0

    @property
    def signs(self) -> tuple[Connection, int]:
        """What becomes ready when it has something to say."""
        return self._pipe, self._process.sentinel

    @property
    def is_over(self) -> bool:
        """Whether its run is, one way or another."""
        return self._pipe.poll() or not self._process.is_alive() or self.end_s <= REAL_TIME.now()

    def begin(self, task: Task) -> None:
        """Give it a run."""
        self._task, self.end_s = task, REAL_TIME.now() + RUN_LIMIT_S
        with contextlib.suppress(OSError):  # it has died; its answer tells
            self._pipe.send(task)

    def answer(self) -> Answer:
        """Return what came of its run; a process without an answer is ended."""
        task, self._task = self._task, None
        if task is None:
            raise AssertionError("a worker is asked for a run that it was not given")
        with contextlib.suppress(EOFError, OSError):
            if self._pipe.poll():
                return Answer(task, self._pipe.recv(), has_crashed=False)
        is_late = self.end_s <= REAL_TIME.now()
        if not is_late:
            self._process.join(_GRACE_S)
        code = self._process.exitcode
        self.kill()
        why = (
            f"took more than {RUN_LIMIT_S:g} s of real time" if is_late else f"its process died, with exit code {code}"
        )
        return Answer(task, why, has_crashed=True)

    def dismiss(self) -> None:
        """Tell it that there is nothing more to do, and wait for its end."""
        self._pipe.close()
        self._process.join(_GRACE_S)
        self.kill()

    def kill(self) -> None:
        """End the process; all that it moves is simulated."""
        self._process.kill()
        self._process.join()
        self._pipe.close()


_GRACE_S: Final = 5.0
"""Real seconds for a process to end by itself."""
