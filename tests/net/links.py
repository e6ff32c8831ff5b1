"""Small ends of a network over real zenoh: a queryable for a robot, gets for a controller."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import zenoh

from eal_actors.clock import SystemClock
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import FleetConfig

PATIENCE_S = 10.0


def free_port() -> int:
    """Return a port that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def fleet_of(network: Mapping[str, object], robots: Mapping[str, str | None], folder: Path = Path()) -> FleetConfig:
    """Return a fleet of robots by name and address; its name is `f`, and keys are in the folder."""
    sections: dict[str, object] = {
        name: {"address": address, "plugins": {"sample": {}}} for name, address in robots.items()
    }
    content = {"version": 1, "name": "f", "network": network, "robots": sections}
    return EALConfigManager.of(content, name=str(folder / "fleet")).fleet


@contextmanager
def answering(session: zenoh.Session, robot: str, asked: list[str] | None = None) -> Iterator[None]:
    """Answer queries for everything of a robot with the robot's name, and show that it lives."""

    def answer(query: zenoh.Query) -> None:
        with query:
            key = str(query.key_expr)
            if asked is not None:
                asked.append(key)
            query.reply(key.replace("*", robot, 1) if "*" in key else key, robot)

    token = session.liveliness().declare_token(f"eal/f/{robot}/_/alive")
    with session.declare_queryable(f"eal/f/{robot}/**", answer), token:
        yield


def ask(session: zenoh.Session, key: str) -> list[str]:
    """Return the answers to a query, in order of their text."""
    replies = session.get(key, timeout=2.0, consolidation=zenoh.ConsolidationMode.NONE)
    return sorted(reply.ok.payload.to_string() for reply in replies if reply.ok is not None)


def eventually(happens: Callable[[], object]) -> bool:
    """Return whether something becomes true, looking often."""
    clock = SystemClock()
    while clock.now() < PATIENCE_S:
        if happens():
            return True
        clock.sleep(0.005)
    return False
