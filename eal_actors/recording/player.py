"""The data and the script of a report's player, which moves the robots on the map of the page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from importlib.resources import files
from typing import Any, Final

from eal_actors.recording.picture import COLOURS, MapPicture
from eal_actors.recording.player_media import player_media
from eal_actors.recording.poses import PoseSample
from eal_actors.recording.run_folder import RunFolder
from eal_actors.recording.timeline import RunTimeline

_RADIUS_M: Final = 0.17
_STILL_M: Final = 0.0005
_STILL_RAD: Final = 0.001


@cache
def player_script() -> str:
    """Return the script."""
    return (files("eal_actors.recording") / "templates" / "player.js").read_text(encoding="utf-8")


def player_data(run: RunFolder, line: RunTimeline, picture: MapPicture | None) -> dict[str, Any]:
    """Return the paths and the steps of a run, and how the map is drawn; rounded to millimetres and milliseconds.

    Samples of a robot that stands still are left out but for the last one, so that pages of long runs stay small.
    """
    media = player_media(run)
    radii_m = media.pop("radii_m")
    robots = {
        name: {
            "colour": COLOURS[number % len(COLOURS)],
            "radius_m": radii_m.get(name, _RADIUS_M),
            **_columns(list(_moving(path))),
        }
        for number, (name, path) in enumerate(run.paths.items())
        if path
    }
    steps = {
        name: [{"label": bar.label, "start_s": bar.start_s, "end_s": bar.end_s, "outcome": bar.outcome} for bar in bars]
        for name, bars in line.bars.items()
    }
    return {
        "duration_s": line.duration_s,
        "map": picture and [picture.zero_x, picture.zero_y, picture.scale_x, picture.scale_y],
        "robots": robots,
        "steps": steps,
        **media,
    }


def _columns(path: Sequence[PoseSample]) -> dict[str, list[float]]:
    columns = zip(("t", "x", "y", "yaw"), zip(*path, strict=True), strict=True)
    return {name: [round(number, 3) for number in column] for name, column in columns}


def _moving(path: Sequence[PoseSample]) -> Iterator[PoseSample]:
    """Yield the samples that differ from the one before or the one after them, and the ends."""
    for index, sample in enumerate(path):
        beside = [path[other] for other in (index - 1, index + 1) if 0 <= other < len(path)]
        if len(beside) < 2 or not all(_is_same(sample, other) for other in beside):
            yield sample


def _is_same(one: PoseSample, other: PoseSample) -> bool:
    distances_m = abs(one.x_m - other.x_m), abs(one.y_m - other.y_m)
    return max(distances_m) < _STILL_M and abs(one.yaw_rad - other.yaw_rad) < _STILL_RAD
