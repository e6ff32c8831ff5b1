"""A folder of frames: which files they are, where odometry had the camera at each, and how a panorama is kept."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.lab.panorama.cylinder import Image
from eal_actors.lab.panorama.stitching import Panorama

PANORAMA: Final = "panorama.png"
"""What a panorama is called in the folder of its frames."""
PICTURES: Final = (".png", ".jpg", ".jpeg")
_TABLES: Final = ("yaws.csv", "frames.csv")
_FILE_COLUMNS: Final = ("file", "frame", "name")


@dataclass(frozen=True, slots=True)
class Shots:
    """The frames of a folder.

    Attributes:
        names: their files' names, in natural order: frame.2.png before frame.10.png.
        frames: RGB images, (h, w, 3).
        yaws_rad: where odometry had the camera at each, counter-clockwise.
    """

    names: tuple[str, ...]
    frames: tuple[Image, ...]
    yaws_rad: tuple[float, ...]


def read_shots(folder: Path, step_rad: float | None = None, leaving_out: Collection[Path] = ()) -> Shots:
    """Read the frames of a folder, and their yaws.

    The yaws come from `yaws.csv` or `frames.csv`, a table with a column `yaw_rad` or `yaw_deg` and, unless its rows are
    in the order of the files, a column `file`; or else from a pose [x_m, y_m, yaw_rad] beside each frame, such as
    `frame.0.json` beside `frame.0.png`, which is how a scenario saves odometry.

    Args:
        folder: the folder; a `panorama.png` in it is no frame.
        step_rad: how far the camera turned right from each frame to the next, in place of the above.
        leaving_out: further files that are no frames.

    Raises:
        ConfigError: no frames, a file that is no picture, a yaw that is missing.

    Thread: blocks while it reads.
    """
    files = _pictures(folder, {*leaving_out, folder / PANORAMA})
    yaws_rad = _yaws(folder, files) if step_rad is None else [-number * step_rad for number in range(len(files))]
    problems: list[Problem] = []
    frames = []
    for file in files:
        frame = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_COLOR) if file.stat().st_size else None
        if frame is None:
            problems.append(Problem(str(file), 0, 0, "", "is no picture that can be read"))
        else:
            frames.append(np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), np.uint8))
    if problems:
        raise ConfigError(problems)
    return Shots(tuple(file.name for file in files), tuple(frames), tuple(yaws_rad))


def save_panorama(panorama: Panorama, file: Path) -> None:
    """Write a panorama as PNG or JPEG, by the file's suffix; a file that is there is replaced.

    Raises:
        ConfigError: the file cannot be written.
    """
    done, content = cv2.imencode(file.suffix, cv2.cvtColor(panorama.image, cv2.COLOR_RGB2BGR))
    try:
        if not done:
            raise OSError(0, "OpenCV cannot encode it")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.tobytes())
    except OSError as error:
        raise ConfigError([Problem(str(file), 0, 0, "", f"cannot be written: {error.strerror}")]) from error


def describe(panorama: Panorama, shots: Shots) -> dict[str, Any]:
    """Return what came of each frame, as JSON can hold it; angles in degrees."""
    error_rad = panorama.closing_error_rad
    height, width, _ = panorama.image.shape
    return {
        "width": width,
        "height": height,
        "left_yaw_deg": math.degrees(panorama.left_yaw_rad),
        "columns_per_deg": panorama.px_per_rad * math.pi / 180,
        "horizon_row": panorama.horizon_px,
        "is_full": panorama.is_full,
        "missing_deg": math.degrees(panorama.missing_rad),
        "closing_error_deg": None if error_rad is None else math.degrees(error_rad),
        "frames": [
            {
                "file": name,
                "odometry_deg": math.degrees(odometry_rad),
                "yaw_deg": None if yaw_rad is None else math.degrees(yaw_rad),
                "placed_by": panorama.placed.get(number),
                "gain": panorama.gains.get(number),
                "left_out": panorama.unplaced.get(number),
            }
            for number, (name, odometry_rad, yaw_rad) in enumerate(
                zip(shots.names, shots.yaws_rad, panorama.yaws_rad, strict=True)
            )
        ],
    }


def _pictures(folder: Path, leaving_out: Collection[Path]) -> list[Path]:
    """Return the pictures of a folder in natural order."""
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise ConfigError([Problem(str(folder), 0, 0, "", f"cannot be read: {error.strerror}")]) from error
    others = {file.resolve() for file in leaving_out}
    found = [file for file in entries if _is_picture(file) and file.resolve() not in others]
    if not found:
        below = sorted(entry.name for entry in entries if entry.is_dir() and any(map(_is_picture, entry.iterdir())))
        hint = f"; there are some in its folder{'s' * (len(below) > 1)} {', '.join(below)}" if below else ""
        raise ConfigError([Problem(str(folder), 0, 0, "", f"holds no frames, {' or '.join(PICTURES)}{hint}")])
    return sorted(found, key=lambda file: (_natural(file.name), file.name))


def _is_picture(file: Path) -> bool:
    return file.suffix.lower() in PICTURES and not file.name.startswith(".") and file.is_file()


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key by which frame.2.png comes before frame.10.png."""
    parts = re.split(r"(\d+)", name.lower())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _yaws(folder: Path, files: Sequence[Path]) -> list[float]:
    for table in _TABLES:
        if (folder / table).is_file():
            return _from_table(folder / table, files)
    poses = [file.with_suffix(".json") for file in files]
    if not any(pose.is_file() for pose in poses):
        known = f"{', '.join(_TABLES)} or {poses[0].name}"
        message = f"nothing tells where the camera looked: there is no {known}. Give the angle between frames (--step)"
        raise ConfigError([Problem(str(folder), 0, 0, "", message)])
    problems: list[Problem] = []
    yaws_rad = [_from_pose(pose, file, problems) for pose, file in zip(poses, files, strict=True)]
    if problems:
        raise ConfigError(problems)
    return yaws_rad


def _from_pose(pose: Path, frame: Path, problems: list[Problem]) -> float:
    if not pose.is_file():
        problems.append(Problem(str(frame), 0, 0, "", f"has no {pose.name} beside it, as others have"))
        return 0.0
    try:
        _, _, yaw_rad = map(float, json.loads(pose.read_text(encoding="utf-8")))
        if math.isfinite(yaw_rad):
            return yaw_rad
    except (ValueError, TypeError):
        pass
    problems.append(Problem(str(pose), 0, 0, "", "must be a pose: [x_m, y_m, yaw_rad]"))
    return 0.0


def _from_table(table: Path, files: Sequence[Path]) -> list[float]:
    """Return the yaw of each file by a table; all that is wrong with the table is raised at once."""
    problems: list[Problem] = []

    def refuse(line: int, message: str) -> None:
        problems.append(Problem(str(table), line, 1 if line else 0, "", message))

    with table.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream, skipinitialspace=True)
        columns = reader.fieldnames or ()
        unit = next((name for name in ("yaw_rad", "yaw_deg") if name in columns), None)
        by = next((name for name in _FILE_COLUMNS if name in columns), None)
        if unit is None:
            refuse(1, f"needs a column yaw_rad or yaw_deg; it has {', '.join(columns) or 'none'}")
            raise ConfigError(problems)
        found: dict[str, float] = {}
        for place, row in enumerate(reader):
            name = str(row[by]).strip() if by else files[place].name if place < len(files) else f"row {place}"
            yaw_rad = _angle(row[unit], unit)
            if yaw_rad is None:
                refuse(reader.line_num, f"{unit} must be a number, not {row[unit]!r}")
            elif name in found:
                refuse(reader.line_num, f"{name} stands here a second time")
            found[name] = yaw_rad or 0.0
    problems += _misses(table, found, files, by_row=by is None)
    if problems:
        raise ConfigError(problems)
    return [found[_named(file, found)] for file in files]


def _angle(text: str | None, unit: str) -> float | None:
    try:
        angle = float(text or "")
    except ValueError:
        return None
    if not math.isfinite(angle):
        return None
    return math.radians(angle) if unit == "yaw_deg" else angle


def _named(file: Path, found: Mapping[str, float]) -> str:
    """Return what a table calls a file: by its name, or by its name without the suffix."""
    return file.name if file.name in found else file.stem


def _misses(table: Path, found: Mapping[str, float], files: Sequence[Path], *, by_row: bool) -> Iterator[Problem]:
    if by_row and len(found) != len(files):
        yield Problem(
            str(table), 0, 0, "", f"has {len(found)} rows for {len(files)} frames; name them in a column `file`"
        )
    elif not by_row:
        for file in files:
            if _named(file, found) not in found:
                yield Problem(str(table), 0, 0, "", f"has no row for {file.name}")
