"""The operations of every peer: readings, commands, frames, many callers, many robots, reconnection."""

from __future__ import annotations

import asyncio
import importlib
import statistics
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Final

from typing_extensions import override

from eal_actors.kernel.clock import REAL_TIME
from tests.net.links import free_port

ROOT: Final = Path(__file__).parents[3]
VALUE: Final = bytes(24)
FRAME: Final = bytes(921_600)
ROBOTS: Final = 100
CALLERS: Final = 8
GIVE_UP_S: Final = 30.0
HOST: Final = "127.0.0.1"
_RETRY_S: Final = 0.002


class Absent(Exception):  # noqa: N818  # it is no error
    """A peer is not installed; the message says how it is."""


def timed(action: Callable[[], object]) -> float:
    """Return how many seconds an action takes."""
    start = time.perf_counter()
    action()
    return time.perf_counter() - start


class Server:
    """A process that serves robots, which can be killed and started anew.

    Args:
        arguments: of the interpreter; it says `up` and ends with its standard input.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        self._arguments = arguments
        self.start()

    def start(self) -> None:
        """Start it, and wait until it is up."""
        self._process = subprocess.Popen(
            [sys.executable, *self._arguments],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        assert self._process.stdout is not None
        if self._process.stdout.readline() != "up\n":
            self.kill()
            raise AssertionError(f"{' '.join(self._arguments)} did not come up")

    @property
    def pid(self) -> int:
        """The number of the process."""
        return self._process.pid

    def kill(self) -> None:
        """End it on the spot."""
        self._process.kill()
        self._process.communicate()


class Peer(ABC):
    """One way to speak to robots of another process; robot 0 has the frames.

    Attributes:
        name: how the table calls it.
        modules: what must be importable for it.
        package: whose version the table names.
        measures: what it can do, by the names of the methods.
    """

    name: ClassVar[str]
    modules: ClassVar[tuple[str, ...]] = ()
    package: ClassVar[str | None] = None
    measures: ClassVar[tuple[str, ...]] = ("get", "command", "callers", "frame", "fan_out", "reconnect")

    def __init__(self) -> None:
        for module in self.modules:
            try:
                importlib.import_module(module)
            except ImportError as error:
                raise Absent(f"{error}; `pip install --group peers` installs it") from error
        self.port = free_port()
        self.server: Server | None = self.serve()

    @property
    def title(self) -> str:
        """Its name, with its version."""
        return self.name if self.package is None else f"{self.name} {version(self.package)}"

    def serve(self) -> Server | None:
        """Start the process of the robots."""
        return Server(["-m", "tests.benchmarks.peers.serve", self.name, str(self.port)])

    def close(self) -> None:
        """Leave nothing behind."""
        if self.server is not None:
            self.server.kill()

    @abstractmethod
    def get(self, count: int) -> float:
        """Return the median seconds of a reading of 24 bytes, one after the other."""

    @abstractmethod
    def command(self, count: int) -> float:
        """Return the median seconds of a command that does nothing, until its answer."""

    @abstractmethod
    def frame(self, count: int) -> float:
        """Return the median seconds of a reading of 921,600 bytes."""

    @abstractmethod
    def callers(self, count: int) -> float:
        """Return the seconds of a reading where 8 callers read at once, each `count` times."""

    @abstractmethod
    def fan_out(self, count: int) -> float:
        """Return the median seconds of one command to each of 100 robots at once, until all have answered."""

    @abstractmethod
    def try_once(self) -> None:
        """Make a reading, connecting anew if that must be done by hand; raises whatever is wrong."""

    def reconnect(self, count: int) -> float:
        """Return the median seconds from when a killed server is up again until a reading is answered."""
        server = self.server
        assert server is not None

        def once() -> float:
            self.try_once()
            server.kill()
            server.start()
            return timed(self._until_answered)

        return statistics.median(once() for _ in range(count))

    def _until_answered(self) -> None:
        end_s = time.perf_counter() + GIVE_UP_S
        while True:
            try:
                self.try_once()
            except Exception:  # whatever a peer raises while its robot is away
                if time.perf_counter() > end_s:
                    raise
                REAL_TIME.sleep(_RETRY_S)
            else:
                return


class SyncPeer(Peer):
    """A peer whose calls block."""

    @abstractmethod
    def handle(self) -> Any:
        """Return what one caller uses: it has `get()`, `command()` and `frame()`, and may have `close()`."""

    def __init__(self) -> None:
        super().__init__()
        self._own = self.handle()

    def get(self, count: int) -> float:
        return statistics.median(timed(self._own.get) for _ in range(count))

    def command(self, count: int) -> float:
        return statistics.median(timed(self._own.command) for _ in range(count))

    def frame(self, count: int) -> float:
        return statistics.median(timed(self._own.frame) for _ in range(count))

    def callers(self, count: int) -> float:
        handles = [self.handle() for _ in range(CALLERS)]
        together = threading.Barrier(CALLERS + 1)

        def call(handle: Any) -> None:
            handle.get()  # connected, and known
            together.wait(GIVE_UP_S)
            for _ in range(count):
                handle.get()
            if hasattr(handle, "close"):
                handle.close()

        with ThreadPoolExecutor(CALLERS) as threads:
            calls = [threads.submit(call, handle) for handle in handles]
            together.wait(GIVE_UP_S)
            seconds = timed(lambda: [one.result(GIVE_UP_S) for one in calls])
        return seconds / (CALLERS * count)


class AsyncPeer(Peer):
    """A peer whose calls are awaited."""

    def __init__(self) -> None:
        super().__init__()
        self.loop = asyncio.new_event_loop()
        self.run(self.connect())

    def run(self, work: Awaitable[Any]) -> Any:
        """Run something to its end."""
        return self.loop.run_until_complete(asyncio.wait_for(work, GIVE_UP_S))

    def close(self) -> None:
        self.run(self.disconnect())
        self.loop.close()
        super().close()

    @abstractmethod
    async def connect(self) -> None:
        """Connect to all robots."""

    @abstractmethod
    async def disconnect(self) -> None:
        """Let go of what `connect` took."""

    @abstractmethod
    async def get_once(self) -> None:
        """Make a reading."""

    @abstractmethod
    async def command_once(self, robot: int) -> None:
        """Give a robot a command."""

    @abstractmethod
    async def frame_once(self) -> None:
        """Read a frame."""

    async def _median(self, work: Callable[[], Awaitable[None]], count: int) -> float:
        durations = []
        for _ in range(count):
            start = time.perf_counter()
            await work()
            durations.append(time.perf_counter() - start)
        return statistics.median(durations)

    def get(self, count: int) -> float:
        return float(self.run(self._median(self.get_once, count)))

    def command(self, count: int) -> float:
        return float(self.run(self._median(lambda: self.command_once(0), count)))

    def frame(self, count: int) -> float:
        return float(self.run(self._median(self.frame_once, count)))

    @override
    def callers(self, count: int) -> float:
        async def call() -> None:
            for _ in range(count):
                await self.get_once()

        async def all_together() -> float:
            start = time.perf_counter()
            await asyncio.gather(*(call() for _ in range(CALLERS)))
            return time.perf_counter() - start

        return float(self.run(all_together())) / (CALLERS * count)

    @override
    def fan_out(self, count: int) -> float:
        async def all_robots() -> None:
            await asyncio.gather(*(self.command_once(robot) for robot in range(ROBOTS)))

        return float(self.run(self._median(all_robots, count)))

    def try_once(self) -> None:
        try:
            self.run(self.get_once())
        except Exception:
            self.run(self.disconnect())
            self.run(self.connect())
            raise
