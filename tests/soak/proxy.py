"""A cable between controllers and robots that can be cut, stalled and slowed: a TCP relay a robot, in one thread."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Mapping
from typing import Self

_CHUNK_BYTES = 65_536
_MAX_CHUNKS = 4096
_WAIT_S = 10.0


class _Cable:
    """One robot's relay. Thread: the loop's.

    Args:
        port: where controllers dial.
        robot_port: where the robot listens.
    """

    def __init__(self, port: int, robot_port: int) -> None:
        self._port = port
        self._robot_port = robot_port
        self._server: asyncio.Server | None = None
        self._flows = asyncio.Event()
        self._flows.set()
        self._delays_s = (0.0, 0.0)
        self._writers: set[asyncio.StreamWriter] = set()

    async def mend(self) -> None:
        self._flows.set()
        self._delays_s = (0.0, 0.0)
        if self._server is None:
            self._server = await asyncio.start_server(self._relay, "127.0.0.1", self._port)

    async def cut(self) -> None:
        """Break what is connected, and refuse what comes."""
        if self._server is not None:
            self._server.close()
            self._server = None
        for writer in self._writers:
            writer.transport.abort()

    async def stall(self) -> None:
        """Let everybody stay connected, and nothing pass."""
        self._flows.clear()

    async def slow(self, away_s: float, back_s: float) -> None:
        """Delay what passes to the robot, and what comes back; nothing overtakes anything."""
        self._delays_s = (away_s, back_s)

    async def _relay(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._robot_port)
        except OSError:
            writer.transport.abort()
            return
        ends = (writer, far_writer)
        self._writers.update(ends)
        try:
            ways: list[asyncio.Queue[tuple[float, bytes]]] = [asyncio.Queue(_MAX_CHUNKS), asyncio.Queue(_MAX_CHUNKS)]
            tasks = {asyncio.create_task(self._read(end, ways[n], n)) for n, end in enumerate((reader, far_reader))}
            tasks |= {asyncio.create_task(self._write(end, ways[n])) for n, end in enumerate((far_writer, writer))}
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                task.cancel()
        finally:
            self._writers.difference_update(ends)
            for end in ends:
                end.transport.abort()

    async def _read(self, reader: asyncio.StreamReader, way: asyncio.Queue[tuple[float, bytes]], number: int) -> None:
        with contextlib.suppress(ConnectionError):
            while data := await reader.read(_CHUNK_BYTES):
                await way.put((asyncio.get_running_loop().time() + self._delays_s[number], data))

    async def _write(self, writer: asyncio.StreamWriter, way: asyncio.Queue[tuple[float, bytes]]) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                due_s, data = await way.get()
                await asyncio.sleep(due_s - asyncio.get_running_loop().time())
                await self._flows.wait()
                writer.write(data)
                await writer.drain()


class Cables:
    """The cables of all robots, for the length of a `with` block.

    Args:
        ports: by the name of the robot, where controllers dial and where the robot listens.

    Thread: any; blocks the caller until what it asks for has happened.
    """

    def __init__(self, ports: Mapping[str, tuple[int, int]]) -> None:
        self._ports = ports
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="cables")
        self._cables: dict[str, _Cable] = {}

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._cables = {robot: _Cable(*ports) for robot, ports in self._ports.items()}
        self._loop.run_forever()

    def _do(self, robot: str, what: str, *arguments: float) -> None:
        async def act() -> None:
            await getattr(self._cables[robot], what)(*arguments)

        asyncio.run_coroutine_threadsafe(act(), self._loop).result(_WAIT_S)

    def mend(self, robot: str) -> None:
        """Make it a good cable again."""
        self._do(robot, "mend")

    def cut(self, robot: str) -> None:
        """Break every connection, and refuse new ones."""
        self._do(robot, "cut")

    def stall(self, robot: str) -> None:
        """Drop all traffic silently."""
        self._do(robot, "stall")

    def slow(self, robot: str, away_s: float, back_s: float) -> None:
        """Delay the traffic to a robot and from it by so many seconds."""
        self._do(robot, "slow", away_s, back_s)

    def __enter__(self) -> Self:
        self._thread.start()
        for robot in self._ports:
            self.mend(robot)
        return self

    def __exit__(self, *_: object) -> None:
        for robot in self._ports:
            self.cut(robot)
        asyncio.run_coroutine_threadsafe(self._drain(), self._loop).result(_WAIT_S)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_WAIT_S)
        self._loop.close()

    async def _drain(self) -> None:
        """Let what was aborted come to its end."""
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
