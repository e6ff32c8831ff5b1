"""The report of a run as one self-contained HTML page: paths, time lines, latencies, images and errors."""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import ConfigError, UnsupportedError
from eal_actors.recording.outline_picture import draw_outline
from eal_actors.recording.picture import MapPicture, draw_map, losses_of
from eal_actors.recording.player import player_data, player_script
from eal_actors.recording.poses import PoseSample, split_at_breaks
from eal_actors.recording.provenance import kept_scenario
from eal_actors.recording.run_folder import RunFolder
from eal_actors.recording.timeline import OF_THE_RUN, RunTimeline, timeline_of
from eal_actors.scenario import load_scenario
from eal_actors.scenario.report.outline import outline

if TYPE_CHECKING:
    from jinja2 import Template

_TEMPLATE: Final = "report.html.j2"
_MOST_IMAGES: Final = 48
_IMAGE_TYPES: Final = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_PNG_SIZES: Final = slice(16, 24)
_MOST_IMAGE_BYTES: Final = 4_000_000
"""A larger image is named, not shown."""


@dataclass(frozen=True, slots=True)
class Latency:
    """Durations of the successful steps with one label, in seconds of the fleet's clock; `count` is of all of them."""

    label: str
    count: int
    median_s: float
    p99_s: float
    longest_s: float
    failures: int


@dataclass(frozen=True, slots=True)
class RobotRow:
    """A row of the page's table of robots."""

    name: str
    outcome: str
    error: str
    steps: int
    busy_s: float
    travelled_m: float | None


@dataclass(frozen=True, slots=True)
class SavedImage:
    """An image that the run saved: its path in the run's folder, and a data URL, or None if it is too large to show.

    It `is_wide` if it is a panorama, which needs the whole width of the page.
    """

    name: str
    url: str | None
    is_wide: bool


def render_report(run: RunFolder, world: WorldModel | None = None) -> str:
    """Return the page, whose paths have the world below them if it is given.

    Raises:
        ScenarioError: the folder is broken.
        UnsupportedError: Jinja is not installed.
    """
    line, arena = timeline_of(run.events), _map_picture(run, world)
    return page_template(_TEMPLATE).render(
        head=_head(run),
        robots=_robot_rows(run, line),
        arena=arena and arena.svg,
        player=player_data(run, line, arena),
        player_script=player_script(),
        outline=_outline_svg(run),
        chart=line,
        contacts=run.summary.contacts if run.summary else [],
        ticks=_ticks(line.duration_s),
        skews=[event["start"] for event in run.events if event["event"] == "started_together"],
        latencies=_latencies(run),
        images=_images(run.path),
        log=line.log,
    )


def page_template(name: str, package: str = "eal_actors.recording") -> Template:
    """Return a template from the folder `templates` of a package; raise UnsupportedError if Jinja is not installed."""
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError as error:
        raise UnsupportedError("the page needs Jinja: pip install 'eal-actors[record]'") from error
    environment = Environment(
        loader=PackageLoader(package, "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": False}  # robots stay in the order of the run
    environment.filters["seconds"] = lambda value: f"{value:.3f}"
    return environment.get_template(name)


def _head(run: RunFolder) -> Mapping[str, Any]:
    summary, first = run.summary, run.events[0] if run.events else {}
    head = {"scenario": first.get("scenario", run.path.name), "fleet": first.get("fleet", ""), "outcome": "unfinished"}
    if summary is None:
        error = "the record is incomplete: its controller crashed or was killed"
        return {**head, "error": error, "facts": {"folder": run.path.name}}
    facts = {
        "started": summary.wall_started,
        "took": f"{summary.duration_s:.3f} s of fleet time",
        "rate": f"{summary.rate}",
        "seed": f"{summary.seed}",
        "scenario file": summary.scenario_file,
        "fleet file": summary.fleet_file,
        "folder": run.path.name,
    }
    if run.breaks_s:
        facts["interrupted"] = f"resumed at {', '.join(f'{time_s:.3f} s' for time_s in run.breaks_s)}"
    error = f"{summary.error.code}: {summary.error.message}" if summary.error else ""
    head = {"scenario": summary.scenario, "fleet": summary.fleet, "outcome": summary.outcome}
    return {**head, "error": error, "facts": facts}


def _robot_rows(run: RunFolder, line: RunTimeline) -> list[RobotRow]:
    rows = []
    for name, bars in line.bars.items():
        if name != OF_THE_RUN:
            robot = run.summary.robots.get(name) if run.summary else None
            outcome = robot.outcome if robot else "unfinished"
            error = robot.error.message if robot and robot.error else ""
            parts = split_at_breaks(run.paths.get(name, []), run.breaks_s)
            travelled_m = sum(map(_length_m, parts)) if parts else None
            rows.append(RobotRow(name, outcome, error, len(bars), sum(b.end_s - b.start_s for b in bars), travelled_m))
    return rows


def _length_m(path: Sequence[PoseSample]) -> float:
    return sum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(path))


def _map_picture(run: RunFolder, world: WorldModel | None) -> MapPicture | None:
    if not any(run.paths.values()):
        return None
    outcomes = {name: robot.outcome for name, robot in run.summary.robots.items()} if run.summary else None
    return draw_map(run.paths, world, outcomes, run.breaks_s, losses_of(run.summary) if run.summary else None)


def _outline_svg(run: RunFolder) -> str | None:
    """Return the tree of the scenario; None if the run has no copy of it, or the copy was changed and is invalid."""
    if not (scenario := kept_scenario(run.path)).is_file():  # opening a pipe would wait for its writer
        return None
    try:
        return draw_outline(list(outline(load_scenario(scenario))))
    except ConfigError:
        return None


def _ticks(duration_s: float) -> list[float]:
    """Return five to ten round times from 0 to the end."""
    if duration_s <= 0:
        return [0.0]
    step_s = 10 ** math.floor(math.log10(duration_s))
    while duration_s / step_s < 5:
        step_s /= 2
    return [number * step_s for number in range(int(duration_s / step_s) + 1)]


def _latencies(run: RunFolder) -> list[Latency]:
    records: dict[str, list[Mapping[str, Any]]] = {}
    for event in run.events:
        if event["event"] == "step_ended":
            records.setdefault(str(event["record"]["label"]), []).append(event["record"])
    found = []
    for label, steps in records.items():
        done_s = sorted(step["end_s"] - step["start_s"] for step in steps if step["outcome"] == "done")
        median_s, p99_s, longest_s = (_quantile(done_s, share) for share in (0.5, 0.99, 1.0))
        found.append(Latency(label, len(steps), median_s, p99_s, longest_s, len(steps) - len(done_s)))
    return found


def _quantile(ordered: Sequence[float], share: float) -> float:
    return ordered[min(len(ordered) - 1, math.floor(share * len(ordered)))] if ordered else math.nan


def _images(folder: Path) -> list[SavedImage]:
    files = sorted(
        (path for path in folder.rglob("*") if path.suffix in _IMAGE_TYPES and path.name != "trajectory.png"),
        key=lambda path: path.relative_to(folder).parts,
    )
    own = [path for path in files if path.is_file() and path.resolve().is_relative_to(folder.resolve())]
    return [_image(folder, path) for path in own[:_MOST_IMAGES]]  # a link could lead to a key, or never end


def _image(folder: Path, path: Path) -> SavedImage:
    name = path.relative_to(folder).as_posix()
    if path.stat().st_size > _MOST_IMAGE_BYTES:
        return SavedImage(name, None, is_wide=False)
    content = path.read_bytes()
    url = f"data:{_IMAGE_TYPES[path.suffix]};base64,{base64.b64encode(content).decode('ascii')}"
    return SavedImage(name, url, is_wide=_is_wide(content))


def _is_wide(content: bytes) -> bool:
    """Return whether an image is a PNG, whose size is at a fixed place, and over three times as wide as high."""
    if not content.startswith(b"\x89PNG") or len(content) < _PNG_SIZES.stop:
        return False
    width, height = struct.unpack(">II", content[_PNG_SIZES])
    return bool(width > 3 * height)
