"""Hulls of robots, plots of values and camera frames for the player of a run, read from its record."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

from eal_actors.kernel.errors import ScenarioError, UnsupportedError
from eal_actors.kernel.log import get_logger
from eal_actors.recording import schemas
from eal_actors.recording.mcap_file import HULLS_TOPIC, RECORD_FILE, RecordedMessage
from eal_actors.recording.run_folder import RunFolder

_MOST_PLOTS: Final = 24
_MOST_POINTS: Final = 1000
"""Points of a plot: it is a thousand units wide."""
_MOST_FRAME_BYTES: Final = 8_000_000
"""All frames of a page together, as texts; beyond, frames are left out evenly."""


def player_media(run: RunFolder) -> dict[str, Any]:
    """Return radii by robot, plots by topic and camera frames by topic; empty ones without a record."""
    media: dict[str, Any] = {"radii_m": {}, "plots": {}, "cameras": {}}
    if not (run.path / RECORD_FILE).is_file():
        return media
    try:
        recorded = run.record.messages
    except (ScenarioError, UnsupportedError) as error:
        get_logger().warning("the player shows no values and frames", reason=str(error))
        return media
    for message in recorded:
        if message.topic == HULLS_TOPIC:
            media["radii_m"] = dict(_radii_m(message.message))
    return media | {"plots": _plots(recorded), "cameras": _cameras(recorded)}


def _radii_m(scene: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for entity in scene["entities"]:
        robot, _, part = entity["id"].rpartition("/")
        if part == "hull" and entity["cylinders"]:
            yield robot, round(entity["cylinders"][0]["size"]["x"] / 2, 4)


def _plots(recorded: Sequence[RecordedMessage]) -> dict[str, dict[str, Any]]:
    """Return the times and values of resources with one number, each with its unit."""
    found: dict[str, dict[str, Any]] = {}
    for message in recorded:
        value = message.message.get("value")
        if message.schema != schemas.VALUE.name or isinstance(value, bool) or not isinstance(value, int | float):
            continue
        if message.topic not in found and len(found) == _MOST_PLOTS:
            continue
        plot = found.setdefault(message.topic, {"unit": message.message["unit"], "t": [], "v": []})
        plot["t"].append(round(message.time_s, 3))
        plot["v"].append(float(f"{value:.6g}"))
    return {topic: _thinned(plot) for topic, plot in found.items() if len(plot["t"]) > 1}


def _thinned(plot: dict[str, Any]) -> dict[str, Any]:
    """Keep the least and the greatest value of each part of a long plot, so that peaks stay."""
    values, count = plot["v"], len(plot["v"])
    if count <= _MOST_POINTS:
        return plot
    kept: dict[int, None] = {}
    parts = _MOST_POINTS // 2
    for part in range(parts):
        indices = range(part * count // parts, (part + 1) * count // parts)
        extremes = min(indices, key=values.__getitem__), max(indices, key=values.__getitem__)
        kept.update(dict.fromkeys(sorted(extremes)))
    return plot | {key: [plot[key][index] for index in kept] for key in ("t", "v")}


def _cameras(recorded: Sequence[RecordedMessage]) -> dict[str, list[tuple[float, str]]]:
    """Return the times and data URLs of camera frames."""
    frames = [message for message in recorded if message.schema == schemas.IMAGE.name]
    size = sum(len(message.message["data"]) for message in frames)
    step = max(1, -(-size // _MOST_FRAME_BYTES))
    found: dict[str, list[tuple[float, str]]] = {}
    seen: dict[str, int] = {}
    for message in frames:
        number = seen[message.topic] = seen.get(message.topic, -1) + 1
        if number % step == 0:
            url = f"data:image/{message.message['format']};base64,{message.message['data']}"
            found.setdefault(message.topic, []).append((round(message.time_s, 3), url))
    return found
