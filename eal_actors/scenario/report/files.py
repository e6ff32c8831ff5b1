"""Saved answers: the suffix of the file sets the format. Images, arrays, texts, tables, and JSON for all but bytes."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Sequence
from collections.abc import Set as AbstractSet
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Final, TypeAlias

from eal_actors.device.data import DataType, EALData
from eal_actors.device.data.pictures import picture_png
from eal_actors.device.info import ValueInfo
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.scenario.report.records import as_json

SUFFIXES: Final = (".csv", ".json", ".npy", ".png", ".txt")
"""The suffixes of files; each sets a format."""
APPENDED: Final = (".csv",)
"""Those of files that grow with every answer; all others hold one answer."""
MAX_COLUMNS: Final = 1000
_NO_IMAGE: Final = "no image of (h, w, 3) unsigned bytes"
_NO_ROW: Final = "no row of a table"


ImageWriter: TypeAlias = Callable[[Path, Any], None]
"""Writes a PNG of an array."""


def check_file_name(name: str) -> None:
    """Raise ScenarioError if a file name of a scenario leads out of its folder."""
    path = PurePosixPath(name)
    if not path.name or path.is_absolute() or ".." in path.parts or "\0" in name:
        raise ScenarioError(f"{name!r} is not a file name inside the run's folder")


def suffix_problem(name: str) -> str | None:
    """Return the problem with the suffix of a file name, or None."""
    suffix = PurePosixPath(name).suffix
    if suffix in SUFFIXES:
        return None
    hint = did_you_mean(suffix.lower(), SUFFIXES)
    found = f"not {suffix}" if suffix else f"and {name!r} has no such ending"
    known = f"saves as {', '.join(SUFFIXES[:-1])} or {SUFFIXES[-1]}"
    return f"{known}, {found}{hint if 'did you mean' in hint else ''}"


def name_problems(name: str, varying: AbstractSet[str], around: Sequence[tuple[str, int | None]]) -> list[str]:
    """Return the problems of a file name in a scenario, with the variables in it that may change during the run.

    The loops around the step, from the outermost, are a variable and its number of passes or None.
    """
    problem = suffix_problem(name)
    if problem is not None:
        return [problem]
    if PurePosixPath(name).suffix in APPENDED or not varying <= {loop for loop, _ in around}:
        return []  # a name with a variable of the run need not occur twice
    problems: dict[str, None] = {}
    for number, (loop, passes) in enumerate(around):
        if passes == 1:
            continue
        if loop not in varying:
            problems[f"each pass of the loop around it overwrites the file: its name lacks ${{{loop}}}"] = None
        elif any(inner == loop for inner, _ in around[number + 1 :]):
            message = "each pass of the outer 'repeat' overwrites the files of the one before: "
            hidden = f"${{{loop}}} is that of the inner 'repeat' here; write one of them as a 'for'"
            problems[message + hidden] = None
    return list(problems)


def answer_problem(name: str, answer: ValueInfo) -> str | None:
    """Return why a file of this name cannot hold the answers of a resource, or None."""
    match PurePosixPath(name).suffix:
        case ".png":
            fits = answer.type is DataType.CHAR and len(answer.shape) == 3 and answer.shape[2] in (3, None)
            lacking = _NO_IMAGE
        case ".npy":
            fits, lacking = bool(answer.shape), "no array"
        case ".txt":
            fits, lacking = answer.type in (DataType.CHAR, DataType.VOID) and not answer.shape, "no text"
        case ".csv":
            fits, lacking = len(answer.shape) <= 1 and answer.type is not DataType.VOID, _NO_ROW
        case _:
            return None
    return (
        None if fits else f"cannot be saved as {PurePosixPath(name).name}: the answer is {answer.describe()}, {lacking}"
    )


def save_answer(value: object, folder: Path, name: str, time_s: float, *, is_kept: bool = True) -> str | None:
    """Write an answer to a file. An existing file is replaced, but a table grows by a row.

    Args:
        value: the answer, an EALData or a status int. An array of unsigned bytes of shape (h, w, 3) is an
            RGB image.
        folder: the folder, created if it does not exist.
        name: the file's name, which may contain folders.
        time_s: the time of the answer, in seconds since the run's start.
        is_kept: whether the file outlives the run; if not, an image is not compressed.

    Returns:
        A note for the user, or None.

    Raises:
        ScenarioError: the name leads out of the folder, or the file cannot hold the value.
        OSError: the file cannot be written.

    Thread: blocks while it writes.
    """
    check_file_name(name)
    path = folder / name
    plain: Any = value.value if isinstance(value, EALData) else value
    if (lacking := _misfit(path.suffix, value, plain)) is not None:
        raise ScenarioError(f"{path.name} cannot hold this value: it is {lacking}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".png":
        return _save_image(path, plain, is_kept=is_kept)
    if path.suffix == ".npy":
        _save_array(path, plain)
    elif path.suffix == ".csv":
        _add_row(path, plain, time_s)
    elif isinstance(plain, bytes):
        path.write_bytes(plain)
    elif path.suffix == ".txt":
        path.write_text(plain, encoding="utf-8")
    else:
        path.write_text(as_json(plain), encoding="utf-8")
    return None


def _misfit(suffix: str, value: object, plain: object) -> str | None:
    """Return why a file of a suffix cannot hold a value, or None."""
    shape = value.shape if isinstance(value, EALData) else None
    match suffix:
        case ".png":
            return None if _is_image(value) else _NO_IMAGE
        case ".npy":
            return None if shape is not None or isinstance(plain, list) else "no array"
        case ".txt":
            return None if isinstance(plain, str | bytes) else "no text"
        case ".csv":
            return None if _is_row(plain, shape or ()) else _NO_ROW
    return "bytes, which JSON has no form for; save them as .txt" if isinstance(plain, bytes) else None


def _is_image(value: object) -> bool:
    return isinstance(value, EALData) and value.dtype == "|u1" and (value.shape or ())[2:] == (3,)


def _is_row(plain: object, shape: tuple[int, ...]) -> bool:
    count = len(plain) if isinstance(plain, list | tuple) else math.prod(shape or (1,))
    return len(shape) <= 1 and count <= MAX_COLUMNS and not isinstance(plain, bytes)


@cache
def image_writer() -> ImageWriter | None:
    """Return a writer of PNG, or None if neither OpenCV nor matplotlib is installed. The first call is slow."""
    try:
        import cv2
    except ImportError:
        return _matplotlib_writer()

    def write(path: Path, image: Any) -> None:
        if not cv2.imwrite(str(path), image[..., ::-1]):  # OpenCV wants blue first
            raise OSError(f"OpenCV could not write {path}")

    return write


def _write_stored(path: Path, image: Any) -> None:
    """Write a PNG without compression: compressing pictures that nobody keeps took 40 % of the time of a proof."""
    path.write_bytes(picture_png(image.tobytes(), image.shape, level=0))


def _matplotlib_writer() -> ImageWriter | None:
    try:
        from matplotlib.image import imsave
    except ImportError:
        return None
    return lambda path, image: imsave(path, image)


def _save_image(path: Path, image: Any, *, is_kept: bool) -> str | None:
    write = image_writer() if is_kept else _write_stored
    if write is not None:
        write(path, image)
        return None
    path = path.with_suffix(".npy")
    _save_array(path, image)
    return f"saved {path.name} in place of a PNG, which needs OpenCV or matplotlib: pip install 'eal-actors[sim]'"


def _add_row(path: Path, plain: Any, time_s: float) -> None:
    """Append a row with the time and the value, or all its elements; the first row has the names of the columns."""
    values = list(plain.tolist() if hasattr(plain, "tolist") else plain) if _is_sequence(plain) else [plain]
    is_new = not path.exists()
    with path.open("a", encoding="utf-8", newline="") as stream:
        table = csv.writer(stream)
        if is_new:
            names = ["value"] if not _is_sequence(plain) else [f"value_{number}" for number in range(len(values))]
            table.writerow(["time_s", *names])
        table.writerow([f"{time_s:.6f}", *values])


def _is_sequence(plain: object) -> bool:
    return isinstance(plain, list | tuple) or hasattr(plain, "tolist")


def _save_array(path: Path, array: Any) -> None:
    import numpy as np

    np.save(path, array, allow_pickle=False)
