"""RosSession: one zenoh session in the ROS 2 graph, with its nodes' publishers, subscriptions, clients and services.

The session is a client of the router (or of a robot that listens), so everything passes one link, which zenoh opens
again after a loss. Only the first opening is ours: until the router is there, it is tried every second in a thread.
Entities are declared when the session opens, and may be made before.

A subscription is a ring in the engine: it keeps the newest messages without running Python, so that a flood costs
nothing here, and `RosSubscription.take` reads them.

Thread: any.
"""

from __future__ import annotations

import json
import os
import re
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Final

import zenoh
from zenoh import handlers

from eal_actors.plugin import PluginError, UnavailableError, get_logger

from . import graph
from .endpoints import RosClient, RosPublisher, RosService, RosSubscription
from .graph import Entity
from .message_types import MessageType, ServiceType

_RETRY_S: Final = 1.0
_OPEN_MS: Final = 500
_MOST_TOKENS: Final = 20_000
"""Entities of the graph that are kept; more are ignored, and logged once."""


class RosSession:
    """A session; nodes and their endpoints are declared in it.

    Args:
        endpoint: of the router, such as `tcp/127.0.0.1:7447`.
        config: a zenoh configuration file, for certificates; its endpoints are replaced.

    Raises:
        PluginError: the configuration file is no zenoh configuration.
    """

    def __init__(self, endpoint: str, domain: int, config: str | None = None) -> None:
        self.endpoint: Final = endpoint
        self.domain: Final = domain
        self._config = _configuration(endpoint, config)
        self._lock = threading.RLock()
        self._session: zenoh.Session | None = None
        self._problem = "not tried yet"
        self._makers: list[Callable[[zenoh.Session], None]] = []
        self._counter = Counter[str]()
        self._graph: dict[str, Entity] = {}
        self._graph_end: Any = None
        self._is_closed = threading.Event()
        self._log = get_logger(router=endpoint)
        self._try_open()
        if self._session is None:
            threading.Thread(target=self._keep_trying, name=f"ros2 {endpoint}", daemon=True).start()

    # Opening.

    def _keep_trying(self) -> None:
        while not self._is_closed.wait(_RETRY_S):
            self._try_open()
            if self._session is not None:
                self._log.info("the router is reached")
                return

    def _try_open(self) -> None:
        try:
            session = zenoh.open(self._config)
        except zenoh.ZError as error:
            self._problem = _reason(error)
            return
        with self._lock:
            if self._is_closed.is_set():
                session.close()  # type: ignore[no-untyped-call]  # untyped in zenoh's stubs
                return
            self._graph_end = session.liveliness().declare_subscriber(
                graph.all_tokens(self.domain), handlers.Callback(self._on_token, indirect=False), history=True
            )
            for make in self._makers:
                make(session)
            self._session = session

    def why_not_ready(self) -> str | None:
        """Return why nothing can be sent or received now."""
        session = self._session
        if session is None:
            return f"cannot reach the zenoh router at {self.endpoint}: {self._problem}"
        if not session.info.routers_zid() and not session.info.peers_zid():
            return f"the zenoh router at {self.endpoint} is gone"
        return None

    def close(self) -> None:
        """End everything; blocks while the link is closed, which the engine bounds."""
        self._is_closed.set()
        with self._lock:
            session, self._session = self._session, None
        if session is not None:
            session.close()  # type: ignore[no-untyped-call]  # untyped in zenoh's stubs

    def require(self) -> zenoh.Session:
        """Return the open session.

        Raises:
            UnavailableError: it is not open.
        """
        session, problem = self._session, self.why_not_ready()
        if session is None or problem:
            raise UnavailableError(problem or "the session is closed")
        return session

    # The graph.

    def _on_token(self, sample: zenoh.Sample) -> None:
        """Follow the graph. Thread: the engine's."""
        key = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.DELETE:
            self._graph.pop(key, None)
        elif (entity := graph.parse_token(key)) is not None:
            if len(self._graph) < _MOST_TOKENS:
                self._graph[key] = entity
            elif not self._counter["graph"]:
                self._counter["graph"] = 1
                self._log.warning("further entities of the ROS 2 graph are ignored", kept=_MOST_TOKENS)

    def entities(self, kind: str, name: str) -> list[Entity]:
        """Return the endpoints of a kind for a topic or service, without our own."""
        own = self.session_id()
        known = list(self._graph.values())
        return [entity for entity in known if entity.kind == kind and entity.topic == name and entity.session != own]

    def session_id(self) -> str:
        """Return the id of the session; empty before it is open."""
        session = self._session
        return "" if session is None else str(session.info.zid())

    def why_absent(self, kind: str, name: str, wanted: MessageType | ServiceType) -> str | None:
        """Return why an endpoint of ours finds no counterpart, a PUBLISHER or SERVICE; None if there is one."""
        if (problem := self.why_not_ready()) is not None:
            return problem
        found = self.entities(kind, name)
        verb, what = ("publishes", "topic") if kind == graph.PUBLISHER else ("serves", "service")
        if not found:
            return f"nobody {verb} {name} in domain {self.domain}"
        if any((one.type_name, one.type_hash) == (wanted.dds_name, wanted.type_hash) for one in found):
            return None
        ours = f"{wanted.name} ({wanted.type_hash[:15]})"
        others = ", ".join(sorted({one.describe_type() for one in found}))
        return f"{what} {name} has another type: there {others}, here {ours}; see `type`, `messages` and `distribution`"

    # Nodes and endpoints.

    def node(self, namespace: str, name: str) -> RosNode:
        """Return a new node, which is in the graph once the session is open."""
        with self._lock:
            number = self._next_id()
            node = RosNode(self, namespace, name, number)
            self.declare(lambda session: node.declare(session))
            return node

    def _next_id(self) -> int:
        with self._lock:
            self._counter["id"] += 1
            return self._counter["id"] - 1

    def declare(self, make: Callable[[zenoh.Session], None]) -> None:
        """Run now if the session is open, else when it opens."""
        with self._lock:
            self._makers.append(make)
            if self._session is not None:
                make(self._session)


class RosNode:
    """A node: the owner of endpoints.

    Attributes:
        namespace: such as `/lab`; `/` for none.
    """

    def __init__(self, session: RosSession, namespace: str, name: str, number: int) -> None:
        self.session: Final = session
        self.namespace: Final = "/" + namespace.strip("/")
        self.name: Final = name
        self._number = number
        self._tokens: list[Any] = []

    def declare(self, session: zenoh.Session) -> None:
        """Put the node into the graph. Thread: holds the session's lock."""
        self._add_token(session, self._entity(graph.NODE, self._number))

    def full_name(self, name: str) -> str:
        """Return the fully qualified name of a topic or service."""
        return graph.full_name(self.namespace, name)

    def publisher(self, topic: str, kind: MessageType) -> RosPublisher:
        """Publish a topic."""
        name, gid = self.full_name(topic), os.urandom(graph.GID_BYTES)
        publisher = RosPublisher(self.session.require, self._key(name, kind), kind, gid)
        self._declare(graph.PUBLISHER, name, kind, publisher.declare, graph.quality())
        return publisher

    def subscription(
        self, topic: str, kind: MessageType, *, depth: int = 1, transient_local: bool = False, max_bytes: int = 1 << 20
    ) -> RosSubscription:
        """Subscribe to a topic; the newest `depth` messages are kept until they are taken."""
        name = self.full_name(topic)
        taker = RosSubscription(name, self._key(name, kind), kind, depth, max_bytes, is_latched=transient_local)
        qos = graph.quality(best_effort=not transient_local, transient_local=transient_local, depth=depth)
        self._declare(graph.SUBSCRIPTION, name, kind, taker.declare, qos)
        return taker

    def client(self, service: str, kind: ServiceType) -> RosClient:
        """Call a service."""
        name = self.full_name(service)
        client = RosClient(self.session.require, name, self._key(name, kind), kind, os.urandom(graph.GID_BYTES))
        self._declare(graph.CLIENT, name, kind, lambda _: None, graph.quality())
        return client

    def service(self, service: str, kind: ServiceType, answer: Callable[[Any], dict[str, Any]]) -> RosService:
        """Serve a service; `answer` gets the request's message and returns the response's fields. Thread: engine's."""
        name = self.full_name(service)
        server = RosService(self._key(name, kind), kind, answer)
        self._declare(graph.SERVICE, name, kind, server.declare, graph.quality())
        return server

    def _key(self, name: str, kind: MessageType | ServiceType) -> str:
        return graph.topic_key(self.session.domain, name, kind.dds_name, kind.type_hash)

    def _declare(
        self,
        kind: str,
        name: str,
        types: MessageType | ServiceType,
        make: Callable[[zenoh.Session], None],
        qos: str,
    ) -> None:
        number = self.session._next_id()  # noqa: SLF001  # one family

        def declare(session: zenoh.Session) -> None:
            make(session)
            self._add_token(session, self._entity(kind, number, name, types.dds_name, types.type_hash, qos))

        self.session.declare(declare)

    def _entity(self, kind: str, number: int, *rest: str) -> Entity:
        return Entity(kind, "", self._number, number, self.namespace, self.name, *rest)

    def _add_token(self, session: zenoh.Session, entity: Entity) -> None:
        entity = replace(entity, session=str(session.info.zid()))
        self._tokens.append(session.liveliness().declare_token(entity.token(self.session.domain)))


def _reason(error: zenoh.ZError) -> str:
    """Return an error of the engine without the places in its source."""
    return re.split(r"\s+at /", str(error))[0].strip()


def _configuration(endpoint: str, file: str | None) -> zenoh.Config:
    settings: Iterable[tuple[str, Any]] = (
        ("mode", "client"),
        ("connect/endpoints", [endpoint]),
        ("connect/timeout_ms", _OPEN_MS),
        ("connect/exit_on_failure", True),
        ("transport/shared_memory/enabled", False),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("transport/link/tx/queue/congestion_control/block/wait_before_close", 500_000),
    )
    try:
        config = zenoh.Config() if file is None else zenoh.Config.from_file(file)
        for key, value in settings:
            config.insert_json5(key, json.dumps(value))
    except zenoh.ZError as error:
        raise PluginError(f"zenoh's configuration is wrong: {_reason(error)}") from error
    return config
