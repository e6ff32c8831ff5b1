"""The bare engines under this project: zenoh alone, with queries as it has them; Pykka alone, within one process."""

from __future__ import annotations

import json
import statistics
import threading
from typing import Any, ClassVar, Final

import pykka
import zenoh
from typing_extensions import override

from eal_actors.kernel.clock import REAL_TIME
from tests.benchmarks.peers.peer import FRAME, GIVE_UP_S, HOST, ROBOTS, VALUE, Peer, SyncPeer, timed

_ANSWERS: Final = {"get": VALUE, "command": b"\x01", "frame": FRAME}


def session(port: int, *, listens: bool, endpoint: str | None = None) -> zenoh.Session:
    """Open a session that knows nobody but the other end, and speaks to it as to another machine.

    Args:
        port: the port.
        listens: whether it listens there.
        endpoint: in place of the port.
    """
    endpoint = endpoint or f"tcp/{HOST}:{port}"
    content = {
        "mode": "peer",
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {"tx": {"queue": {"size": {"data": 16}}}},  # with two, frames take twice as long
        },
        "listen": {"endpoints": [endpoint] if listens else []},
        "connect": {
            "endpoints": [] if listens else [endpoint],
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_init_ms": 100, "period_max_ms": 1000, "period_increase_factor": 2},
        },
    }
    return zenoh.open(zenoh.Config.from_json5(json.dumps(content)))


def serve_zenoh(port: int) -> zenoh.Session:
    """Serve a hundred robots."""
    opened = session(port, listens=True)

    def answer(query: zenoh.Query) -> None:
        key = str(query.key_expr)
        with query:
            query.reply(key, _ANSWERS[key.rpartition("/")[2]], express=True)

    for robot in range(ROBOTS):
        opened.declare_queryable(f"bare/{robot}/**", zenoh.handlers.Callback(answer, indirect=False))
    return opened


class _Handle:
    def __init__(self, opened: zenoh.Session) -> None:
        self._session = opened

    def ask(self, keys: list[str]) -> None:
        """Ask all the keys at once, and wait for all answers."""
        left, lock, done = len(keys), threading.Lock(), threading.Event()

        def heard(reply: zenoh.Reply) -> None:
            nonlocal left
            if reply.ok is None:
                return
            reply.ok.payload.to_bytes()
            with lock:
                left -= 1
                if left == 0:
                    done.set()

        for key in keys:
            self._session.get(
                key,
                zenoh.handlers.Callback(heard, done.set, indirect=False),
                consolidation=zenoh.ConsolidationMode.NONE,
                express=True,
                timeout=GIVE_UP_S,
            )
        if not done.wait(GIVE_UP_S) or left:
            if len(keys) == 1:
                raise ConnectionError("no answer")
            while left:
                done.clear()
                if not done.wait(GIVE_UP_S):
                    raise ConnectionError("no answer")

    def get(self) -> None:
        self.ask(["bare/0/get"])

    def command(self) -> None:
        self.ask(["bare/0/command"])

    def frame(self) -> None:
        self.ask(["bare/0/frame"])


def serve_publications(port: int) -> zenoh.Session:
    """Serve a hundred robots without queries: a call and its answer are a publication each."""
    opened = session(port, listens=True)
    publishers = {str(robot): _publisher(opened, f"answers/{robot}") for robot in range(ROBOTS)}
    calls = opened.declare_subscriber("calls/**", zenoh.handlers.FifoChannel(ROBOTS))

    def answer() -> None:
        for sample in calls:
            _, robot, what = str(sample.key_expr).split("/")
            publishers[robot].put(_ANSWERS[what])

    threading.Thread(target=answer, daemon=True).start()
    return opened


def _publisher(opened: zenoh.Session, key: str) -> zenoh.Publisher:
    return opened.declare_publisher(key, congestion_control=zenoh.CongestionControl.BLOCK, express=True)


class _PublishingHandle:
    """One caller at a time, which reads the answers itself: nothing here tells whose answer came."""

    def __init__(self, opened: zenoh.Session) -> None:
        self._session = opened
        self._answers = opened.declare_subscriber("answers/*", zenoh.handlers.FifoChannel(ROBOTS))
        self._publishers: dict[str, zenoh.Publisher] = {}

    def ask(self, keys: list[str]) -> None:
        """Ask all the keys at once, and wait for all answers."""
        for key in keys:
            if key not in self._publishers:
                self._publishers[key] = _publisher(self._session, key)
            self._publishers[key].put(b"")
        for _ in keys:
            self._answers.recv().payload.to_bytes()

    def find(self) -> None:
        """Ask once, and wait for a moment: messages that are published before discovery are lost without an answer."""
        self._session.put("calls/0/get", b"")
        for _ in range(100):
            if self._answers.try_recv() is not None:
                return
            REAL_TIME.sleep(0.002)
        raise ConnectionError("no answer")

    def get(self) -> None:
        self.ask(["calls/0/get"])

    def command(self) -> None:
        self.ask(["calls/0/command"])

    def frame(self) -> None:
        self.ask(["calls/0/frame"])


class Zenoh(SyncPeer):
    """The network's engine: no leases, receipts or types."""

    name = "bare zenoh"
    package: ClassVar[str | None] = "eclipse-zenoh"
    caller: ClassVar[type[Any]] = _Handle
    root: ClassVar[str] = "bare"

    def __init__(self) -> None:
        self._session: zenoh.Session | None = None
        super().__init__()
        self._until_answered()

    def handle(self) -> Any:
        """All callers share one session."""
        if self._session is None:
            self._session = session(self.port, listens=False)
        return self.caller(self._session)

    def fan_out(self, count: int) -> float:
        keys = [f"{self.root}/{robot}/command" for robot in range(ROBOTS)]
        return statistics.median(timed(lambda: self._own.ask(keys)) for _ in range(count))

    def try_once(self) -> None:
        """The session connects by itself."""
        self._own.get()

    def close(self) -> None:
        if self._session is not None:
            self._session.close()  # type: ignore[no-untyped-call]  # zenoh's stubs say nothing of it
        super().close()


class Publications(Zenoh):
    """The engine's floor: declared publishers, channels and a caller that waits for the channel itself."""

    name = "zenoh's floor"
    package = None
    measures = ("get", "command", "frame", "fan_out")
    caller = _PublishingHandle
    root = "calls"

    def try_once(self) -> None:
        """Ask once; see _PublishingHandle.find."""
        self._own.find()


class _Lamp(pykka.ThreadingActor):
    def on_receive(self, message: Any) -> Any:
        return _ANSWERS[message]


class _ActorHandle:
    def __init__(self, actor: pykka.ActorRef[Any]) -> None:
        self._actor = actor

    def get(self) -> None:
        self._actor.ask("get")

    def command(self) -> None:
        self._actor.ask("command")


class Pykka(SyncPeer):
    """The actors' engine, within one process: one hop, and no network at all."""

    name = "bare Pykka"
    package = "pykka"
    measures = ("get", "command", "callers", "fan_out")

    def __init__(self) -> None:
        self._actors = [_Lamp.start() for _ in range(ROBOTS)]
        super().__init__()

    def serve(self) -> None:
        """There is no other process."""

    def handle(self) -> _ActorHandle:
        return _ActorHandle(self._actors[0])

    @override
    def fan_out(self, count: int) -> float:
        def once() -> None:
            pykka.get_all([actor.ask("command", block=False) for actor in self._actors])

        return statistics.median(timed(once) for _ in range(count))

    def try_once(self) -> None:
        self._own.get()

    def close(self) -> None:
        for actor in self._actors:
            actor.stop()


ENGINES: Final[tuple[type[Peer], ...]] = (Zenoh, Publications, Pykka)
