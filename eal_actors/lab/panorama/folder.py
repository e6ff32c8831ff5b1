"""Folder of frames: reading the frames and their yaws, and writing a panorama."""

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

from eal_actors.kernel.errors import ConfigError, Problem, file_error, writing
from eal_actors.lab.panorama.cylinder import Image
from eal_actors.lab.panorama.stitching import Panorama

PANORAMA: Final = "panorama.png"
"""File name of a panorama in the folder of its frames."""
PICTURES: Final = (".png", ".jpg", ".jpeg")
_TABLES: Final = ("yaws.csv", "frames.csv")
_FILE_COLUMNS: Final = ("file", "frame", "name")


@dataclass(frozen=True, slots=True)
class CameraFrames:
    """The frames of a folder, in natural order of their names: frame.2.png before frame.10.png.

    The yaws are those of the camera by odometry, counter-clockwise.
    """

    names: tuple[str, ...]
    images: tuple[Image, ...]
    yaws_rad: tuple[float, ...]


def read_frames(folder: Path, step_rad: float | None = None, exclude: Collection[Path] = ()) -> CameraFrames:
    """Read the frames of a folder, and their yaws.

    The yaws come from `yaws.csv` or `frames.csv`, a table with a column `yaw_rad` or `yaw_deg` and a column `file`,
    which may be missing if the rows are in the order of the files. Without a table they come from a pose
    [x_m, y_m, yaw_rad] beside each frame, such as `frame.0.json` beside `frame.0.png`, as a scenario saves odometry.

    Args:
        folder: the folder; a `panorama.png` in it is not a frame.
        step_rad: turn to the right from each frame to the next, instead of the above.
        exclude: other files that are not frames.

    Raises:
        ConfigError: there are no frames, a file is not a picture, or a yaw is missing.

    Thread: blocks while it reads.
    """
    files = _pictures(folder, {*exclude, folder / PANORAMA})
    yaws_rad = _yaws(folder, files) if step_rad is None else [-number * step_rad for number in range(len(files))]
    problems: list[Problem] = []
    frames = []
    for file in files:
        frame = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_COLOR) if file.stat().st_size else None
        if frame is None:
            problems.append(Problem(str(file), 0, 0, "", "cannot be read as a picture"))
        else:
            frames.append(np.asarray(cv2.cvtColor(frame, cv2.COLOR_BGR2RGB), np.uint8))
    if problems:
        raise ConfigError(problems)
    return CameraFrames(tuple(file.name for file in files), tuple(frames), tuple(yaws_rad))


def folders_of_robots(run: Path) -> list[Path]:
    """Return the folders of the robots that saved frames in a run; raise ConfigError if there are none."""
    found = sorted(
        folder
        for folder in run.iterdir()
        if folder.is_dir() and any(_is_picture(file) and file.name != PANORAMA for file in folder.iterdir())
    )
    if not found:
        raise file_error(run, f"is a run in which no robot saved {' or '.join(PICTURES)}")
    return found


def save_panorama(panorama: Panorama, file: Path) -> None:
    """Write a panorama as PNG or JPEG, by the file's suffix; raise ConfigError if it cannot be written."""
    done, content = cv2.imencode(file.suffix, cv2.cvtColor(panorama.image, cv2.COLOR_RGB2BGR))
    with writing(file):
        if not done:
            raise OSError(0, "OpenCV cannot encode it")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(content.tobytes())


def describe(panorama: Panorama, frames: CameraFrames) -> dict[str, Any]:
    """Return a report on the panorama and each frame as JSON values; angles in degrees."""
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
                zip(frames.names, frames.yaws_rad, panorama.yaws_rad, strict=True)
            )
        ],
    }


def _pictures(folder: Path, exclude: Collection[Path]) -> list[Path]:
    """Return the pictures of a folder in natural order."""
    try:
        entries = list(folder.iterdir())
    except OSError as error:
        raise file_error(folder, f"cannot be read: {error.strerror}") from error
    others = {file.resolve() for file in exclude}
    found = [file for file in entries if _is_picture(file) and file.resolve() not in others]
    if not found:
        below = sorted(entry.name for entry in entries if entry.is_dir() and any(map(_is_picture, entry.iterdir())))
        hint = f"; found in its folder{'s' * (len(below) > 1)} {', '.join(below)}" if below else ""
        raise file_error(folder, f"holds no frames, {' or '.join(PICTURES)}{hint}")
    return sorted(found, key=lambda file: (_natural(file.name), file.name))


def _is_picture(file: Path) -> bool:
    return file.suffix.lower() in PICTURES and not file.name.startswith(".") and file.is_file()


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a sort key that puts frame.2.png before frame.10.png."""
    parts = re.split(r"(\d+)", name.lower())
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _yaws(folder: Path, files: Sequence[Path]) -> list[float]:
    for table in _TABLES:
        if (folder / table).is_file():
            return _from_table(folder / table, files)
    poses = [file.with_suffix(".json") for file in files]
    if not any(pose.is_file() for pose in poses):
        known = f"{', '.join(_TABLES)} or {poses[0].name}"
        raise file_error(folder, f"has no yaws: no {known}. Give the angle between frames (--step)")
    problems: list[Problem] = []
    yaws_rad = [_from_pose(pose, file, problems) for pose, file in zip(poses, files, strict=True)]
    if problems:
        raise ConfigError(problems)
    return yaws_rad


def _from_pose(pose: Path, frame: Path, problems: list[Problem]) -> float:
    if not pose.is_file():
        problems.append(Problem(str(frame), 0, 0, "", f"has no {pose.name} beside it, unlike other frames"))
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
    """Return the yaw of each file from a table; raise ConfigError with all of the table's problems."""
    with table.open(newline="", encoding="utf-8-sig", errors="replace") as stream:
        reader = csv.DictReader(stream, skipinitialspace=True)
        columns = reader.fieldnames or ()
        unit = _first_in(columns, ("yaw_rad", "yaw_deg"))
        if unit is None:
            message = f"needs a column yaw_rad or yaw_deg; it has {', '.join(columns) or 'none'}"
            raise ConfigError([Problem(str(table), 1, 1, "", message)])
        key = _first_in(columns, _FILE_COLUMNS)
        try:
            found, problems = _read_rows(table, reader, unit, key, files)
        except csv.Error as error:
            raise ConfigError([Problem(str(table), reader.line_num, 1, "", f"is no table: {error}")]) from error
    problems += _missing_rows(table, found, files, by_row=key is None)
    if problems:
        raise ConfigError(problems)
    return [found[_table_name(file, found)] for file in files]


def _first_in(columns: Sequence[str], names: Sequence[str]) -> str | None:
    return next((name for name in names if name in columns), None)


def _read_rows(
    table: Path, reader: csv.DictReader[str], unit: str, key: str | None, files: Sequence[Path]
) -> tuple[dict[str, float], list[Problem]]:
    """Return the yaws by file name, and the problems of the rows; without a key, rows are in the order of the files."""
    names = iter(file.name for file in files)
    found: dict[str, float] = {}
    problems: list[Problem] = []
    for number, row in enumerate(reader):
        name = str(row[key]).strip() if key else next(names, f"row {number}")
        yaw_rad = _angle(row[unit], unit)
        if yaw_rad is None or name in found:
            wrong = f"{unit} must be a number, not {row[unit]!r}" if yaw_rad is None else f"{name} is repeated"
            problems.append(Problem(str(table), reader.line_num, 1, "", wrong))
        found[name] = yaw_rad or 0.0
    return found, problems


def _angle(text: str | None, unit: str) -> float | None:
    try:
        angle = float(text or "")
    except ValueError:
        return None
    if not math.isfinite(angle):
        return None
    return math.radians(angle) if unit == "yaw_deg" else angle


def _table_name(file: Path, found: Mapping[str, float]) -> str:
    """Return the name of a file in a table: its name with or without the suffix."""
    return file.name if file.name in found else file.stem


def _missing_rows(table: Path, found: Mapping[str, float], files: Sequence[Path], *, by_row: bool) -> Iterator[Problem]:
    if by_row and len(found) != len(files):
        yield Problem(
            str(table), 0, 0, "", f"has {len(found)} rows for {len(files)} frames; name them in a column `file`"
        )
    elif not by_row:
        for file in files:
            if _table_name(file, found) not in found:
                yield Problem(str(table), 0, 0, "", f"has no row for {file.name}")
