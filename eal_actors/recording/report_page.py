"""One self-contained HTML page that tells of a run: paths, time lines, latencies, frames and errors."""

from __future__ import annotations

import base64
import math
import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from eal_actors.device.world import WorldModel
from eal_actors.kernel.errors import UnsupportedError
from eal_actors.recording.notes import OF_THE_RUN
from eal_actors.recording.picture import trajectory_svg
from eal_actors.recording.pose_sample import PoseSample, stretches
from eal_actors.recording.run_folder import RunFolder
from eal_actors.recording.timeline import TimeLine, time_lines

_TEMPLATE: Final = "report.html.j2"
_MOST_FRAMES: Final = 48
_FRAME_SUFFIXES: Final = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_PNG_SIZES: Final = slice(16, 24)
_MOST_FRAME_BYTES: Final = 4_000_000
"""Of one picture; what is larger is named, not shown."""


@dataclass(frozen=True, slots=True)
class Latency:
    """How long the calls of one kind took, in seconds of the fleet's clock.

    Attributes:
        label: resource and command.
        count: how many there were.
        median_s: of those that were done.
        p99_s: 99 of 100 were done within it.
        longest_s: of those that were done.
        failures: how many were not done.
    """

    label: str
    count: int
    median_s: float
    p99_s: float
    longest_s: float
    failures: int


@dataclass(frozen=True, slots=True)
class RobotRow:
    """What the page's first table says of a robot."""

    name: str
    outcome: str
    error: str
    calls: int
    busy_s: float
    travelled_m: float | None


@dataclass(frozen=True, slots=True)
class Frame:
    """A picture that the run saved.

    Attributes:
        name: its path in the run's folder.
        url: itself as a data URL; None for one that is too large to show.
        is_wide: it is a panorama, which wants the whole width of the page.
    """

    name: str
    url: str | None
    is_wide: bool


def render_report(run: RunFolder, world: WorldModel | None = None) -> str:
    """Return the page.

    Args:
        run: the run's folder.
        world: the arena under the paths; None draws just the paths.

    Raises:
        ScenarioError: the folder is broken.
        UnsupportedError: Jinja is not installed.
    """
    try:
        from jinja2 import Environment, PackageLoader, StrictUndefined
    except ImportError as error:
        raise UnsupportedError("a report needs Jinja: pip install 'eal-actors[record]'") from error
    environment = Environment(
        loader=PackageLoader("eal_actors.recording", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["seconds"] = lambda value: f"{value:.3f}"
    lines = time_lines(run.events)
    return environment.get_template(_TEMPLATE).render(
        head=_head(run),
        robots=_robot_rows(run, lines),
        arena=_arena_svg(run, world),
        chart=lines,
        ticks=_ticks(lines.duration_s),
        skews=_skews(run.events),
        latencies=_latencies(run),
        frames=_frames(run.path),
        notes=lines.notes,
    )


def _head(run: RunFolder) -> Mapping[str, Any]:
    summary, first = run.summary, run.events[0] if run.events else {}
    if summary is None:
        return {
            "scenario": first.get("scenario", run.path.name),
            "fleet": first.get("fleet", ""),
            "outcome": "unfinished",
            "error": "the record ends before the run did: its controller crashed or was killed",
            "facts": {"folder": run.path.name},
        }
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
        facts["was cut off"] = f"went on at {', '.join(f'{time_s:.3f} s' for time_s in run.breaks_s)}"
    error = f"{summary.error.code}: {summary.error.message}" if summary.error else ""
    return {
        "scenario": summary.scenario,
        "fleet": summary.fleet,
        "outcome": summary.outcome,
        "error": error,
        "facts": facts,
    }


def _robot_rows(run: RunFolder, lines: TimeLine) -> list[RobotRow]:
    rows = []
    for name, bars in lines.bars.items():
        if name == OF_THE_RUN:
            continue
        fared = run.summary.robots.get(name) if run.summary else None
        path = run.paths.get(name)
        rows.append(
            RobotRow(
                name,
                fared.outcome if fared else "unfinished",
                fared.error.message if fared and fared.error else "",
                len(bars),
                sum(bar.end_s - bar.start_s for bar in bars),
                sum(map(_length_m, stretches(path, run.breaks_s))) if path else None,
            )
        )
    return rows


def _length_m(path: Sequence[PoseSample]) -> float:
    return sum(math.hypot(b.x_m - a.x_m, b.y_m - a.y_m) for a, b in pairwise(path))


def _arena_svg(run: RunFolder, world: WorldModel | None) -> str | None:
    if not any(run.paths.values()):
        return None
    outcomes = {name: robot.outcome for name, robot in run.summary.robots.items()} if run.summary else None
    return trajectory_svg(run.paths, world, outcomes, run.breaks_s)


def _ticks(duration_s: float) -> list[float]:
    """Return five to ten round times from 0 to the end."""
    if duration_s <= 0:
        return [0.0]
    step_s = 10 ** math.floor(math.log10(duration_s))
    while duration_s / step_s < 5:
        step_s /= 2
    return [number * step_s for number in range(int(duration_s / step_s) + 1)]


def _skews(events: Iterable[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the starts that robots made together, each as the report has it."""
    return [event["start"] for event in events if event["event"] == "started_together"]


def _latencies(run: RunFolder) -> list[Latency]:
    durations: dict[str, list[float]] = {}
    failures: dict[str, int] = {}
    for event in run.events:
        if event["event"] != "step_ended":
            continue
        record = event["record"]
        label = str(record["label"])
        durations.setdefault(label, [])
        if record["outcome"] == "done":
            durations[label].append(record["end_s"] - record["start_s"])
        else:
            failures[label] = failures.get(label, 0) + 1
    return [
        Latency(
            label,
            len(taken) + failures.get(label, 0),
            _quantile(taken, 0.5),
            _quantile(taken, 0.99),
            max(taken, default=math.nan),
            failures.get(label, 0),
        )
        for label, taken in durations.items()
    ]


def _quantile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, math.floor(share * len(ordered)))] if ordered else math.nan


def _frames(folder: Path) -> list[Frame]:
    files = sorted(
        (path for path in folder.rglob("*") if path.suffix in _FRAME_SUFFIXES and path.name != "trajectory.png"),
        key=lambda path: path.relative_to(folder).parts,
    )
    return [_frame(folder, path) for path in files[:_MOST_FRAMES]]


def _frame(folder: Path, path: Path) -> Frame:
    name = path.relative_to(folder).as_posix()
    if path.stat().st_size > _MOST_FRAME_BYTES:
        return Frame(name, None, is_wide=False)
    content = path.read_bytes()
    url = f"data:{_FRAME_SUFFIXES[path.suffix]};base64,{base64.b64encode(content).decode('ascii')}"
    return Frame(name, url, is_wide=_is_wide(content))


def _is_wide(content: bytes) -> bool:
    """Return whether a PNG, which tells its size at a fixed place, is more than three times as wide as it is high."""
    if not content.startswith(b"\x89PNG") or len(content) < _PNG_SIZES.stop:
        return False
    width, height = struct.unpack(">II", content[_PNG_SIZES])
    return bool(width > 3 * height)
