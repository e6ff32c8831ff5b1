"""Minimal robots and controllers over real zenoh links; a robot answers calls with its name."""

from __future__ import annotations

import contextlib
import itertools
import queue
import socket
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import zenoh

from eal_actors.kernel.clock import SystemClock
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig

PATIENCE_S = 30.0
MOMENT_S = 0.3
"""Real seconds after which a call that has no (further) answer is taken to get none; what is to come is asked for
again, and what is not to come is followed by something that is."""


_given: set[int] = set()


def free_port() -> int:
    """Return a free port that this process did not return before."""
    with ExitStack() as held:
        while True:
            probe = held.enter_context(socket.socket())
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
            if port not in _given:
                _given.add(port)
                return port


def fleet_of(network: Mapping[str, object], robots: Mapping[str, str | None], folder: Path = Path()) -> FleetConfig:
    """Return a fleet of robots by name and address; its name is `f`, and keys are in the folder."""
    sections: dict[str, object] = {
        name: {"address": address, "plugins": {"sample": {}}} for name, address in robots.items()
    }
    content = {"version": 1, "name": "f", "network": network, "robots": sections}
    return EALConfigManager.of(content, name=str(folder / "fleet")).fleet


@contextmanager
def answering(session: zenoh.Session, robot: str, asked: list[str] | None = None) -> Iterator[None]:
    """Answer a robot's calls with its name and declare it alive; note the keys of calls without their callers."""
    due: queue.SimpleQueue[str | None] = queue.SimpleQueue()  # zenoh's threads must not wait for a link

    def hear(call: zenoh.Sample) -> None:
        key, caller, client = str(call.key_expr).rsplit("/", 2)
        if asked is not None:
            asked.append(key)
        due.put(f"eal/f/@answers/{caller}/{client}/{robot}")

    def answer() -> None:
        while (key := due.get()) is not None:
            session.put(key, robot)

    answers = threading.Thread(target=answer)
    answers.start()
    try:
        handler = zenoh.handlers.Callback(hear, indirect=False)
        with (
            session.declare_subscriber(f"eal/f/{robot}/*/*/*/*", handler),
            session.liveliness().declare_token(f"eal/f/@alive/3/{robot}"),
        ):
            yield
    finally:
        due.put(None)
        answers.join()


class Wire:
    """A TCP link to a port of this machine that can be held and cut; new connections still get through.

    Args:
        port: where the other end listens.

    Attributes:
        port: where to dial.
    """

    def __init__(self, port: int) -> None:
        self._target = port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._ends: list[socket.socket] = []
        self._flows = threading.Event()
        self._flows.set()
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # it is closed
            while True:
                near, _ = self._listener.accept()
                try:
                    far = socket.create_connection(("127.0.0.1", self._target))
                except OSError:
                    near.close()
                    continue
                self._ends += [near, far]
                for pair in ((near, far, None), (far, near, self._flows)):
                    threading.Thread(target=self._carry, args=pair, daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket, flows: threading.Event | None) -> None:
        with contextlib.suppress(OSError):  # it is cut
            while data := source.recv(65536):
                if flows is not None:
                    flows.wait()
                sink.sendall(data)
        for end in (source, sink):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def hold(self) -> None:
        """Hold back what the dialled end sends."""
        self._flows.clear()

    def flow(self) -> None:
        """Let it pass again."""
        self._flows.set()

    def cut(self) -> None:
        """Cut the present connections; what is held back is lost."""
        for end in self._ends:
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)
        self._flows.set()

    def close(self) -> None:
        """Close the port and all connections."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.cut()
        for end in self._ends:
            end.close()


_numbers = itertools.count()


def ask(session: zenoh.Session, key: str, caller: str = "_", *, least: int = 0, hears: str | None = None) -> list[str]:
    """Call a method, and return which robots answer before there is silence for a moment, in order.

    Args:
        session: of the controller.
        key: of the method, without its caller; `*` may stand for parts of it.
        caller: in whose name.
        least: how many answers there must be, for which it waits longer.
        hears: whose answers to listen for; the caller's if None.
    """
    heard: list[str] = []
    client = f"c{next(_numbers)}"
    came = threading.Event()

    def hear(answer: zenoh.Sample) -> None:
        heard.append(answer.payload.to_string())
        came.set()

    handler = zenoh.handlers.Callback(hear, indirect=False)
    with session.declare_subscriber(f"eal/f/@answers/{hears or caller}/{client}/*", handler):
        session.put(f"{key}/{caller}/{client}", b"", congestion_control=zenoh.CongestionControl.BLOCK)
        while came.wait(MOMENT_S if len(heard) >= least else PATIENCE_S):
            came.clear()
    return sorted(heard)


def eventually(happens: Callable[[], object]) -> bool:
    """Poll a condition; return whether it becomes true in time."""
    clock = SystemClock()
    while clock.now() < PATIENCE_S:
        if happens():
            return True
        clock.sleep(0.005)
    return False
