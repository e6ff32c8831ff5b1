"""The table of a fleet's robots that notebooks show."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from html import escape

from eal_actors.actors.handles import RobotHandle
from eal_actors.managers.fleet_model import FleetConfig


def fleet_table(config: FleetConfig, robots: Mapping[str, RobotHandle]) -> str:
    """Return all robots, with those that are connected, as HTML: name, type, state, tags and resources, escaped."""
    rows = []
    for name, robot in config.robots.items():
        handle = robots.get(name)
        state = handle.state.value if handle is not None else "closed"
        resources = ", ".join(handle) if handle is not None else ""
        rows.append(_row("td", (name, robot.type or "", state, ", ".join(sorted(robot.tags)), resources)))
    heading = _row("th", ("robot", "type", "state", "tags", "resources"))
    caption = f"Fleet {config.name}: {len(config.robots)} robots"
    return f"<table><caption>{escape(caption)}</caption>{heading}{''.join(rows)}</table>"


def _row(cell: str, texts: Iterable[str]) -> str:
    return f"<tr>{''.join(f'<{cell}>{escape(text)}</{cell}>' for text in texts)}</tr>"
