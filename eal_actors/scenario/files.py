"""Keep answers in files: images as PNG, arrays, texts, bytes, and everything else as JSON."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path, PurePosixPath
from typing import Any, Protocol

from eal_actors.data import EALData
from eal_actors.errors import ScenarioError


class _ImageWriter(Protocol):
    def __call__(self, path: Path, image: Any) -> None: ...


def check_file_name(name: str) -> None:
    """Raise ScenarioError unless a name, as scenarios give it, stays inside its folder."""
    path = PurePosixPath(name)
    if not path.name or path.is_absolute() or ".." in path.parts or "\0" in name:
        raise ScenarioError(f"{name!r} is no name of a file inside the run's folder")


def save_answer(value: object, folder: Path, name: str) -> str | None:
    """Write an answer to a file; one that is there is replaced.

    Args:
        value: what the call answered, an EALData or a status int. An array of unsigned bytes of shape (h, w, 3) is an
            RGB image.
        folder: where to; made if it is not there.
        name: the file's name, which may lead into folders below.

    Returns:
        What its user should know, or None.

    Raises:
        ScenarioError: the name leads elsewhere, or the value and the name do not go together.
        OSError: the file cannot be written.

    Thread: blocks while it writes.
    """
    check_file_name(name)
    path, note = folder / name, None
    path.parent.mkdir(parents=True, exist_ok=True)
    plain: Any = value.value if isinstance(value, EALData) else value
    if isinstance(value, EALData) and value.shape is not None:
        is_image = value.dtype == "|u1" and len(value.shape) == 3 and value.shape[2] == 3
        if is_image and path.suffix == ".png":
            note = _save_image(path, plain)
        elif path.suffix == ".npy":
            _save_array(path, plain)
        else:
            _save_text(path, json.dumps(plain.tolist()))
    elif isinstance(plain, bytes):
        _refuse_image_name(path)
        path.write_bytes(plain)
    else:
        _save_text(path, plain if isinstance(plain, str) else json.dumps(plain))
    return note


@cache
def image_writer() -> _ImageWriter | None:
    """Return what writes a PNG, or None where neither OpenCV nor matplotlib is installed. The first call is slow."""
    try:
        import cv2
    except ImportError:
        return _matplotlib_writer()

    def write(path: Path, image: Any) -> None:
        if not cv2.imwrite(str(path), image[..., ::-1]):  # OpenCV wants blue first
            raise OSError(f"OpenCV could not write {path}")

    return write


def _matplotlib_writer() -> _ImageWriter | None:
    try:
        from matplotlib.image import imsave
    except ImportError:
        return None
    return lambda path, image: imsave(path, image)


def _save_image(path: Path, image: Any) -> str | None:
    write = image_writer()
    if write is not None:
        write(path, image)
        return None
    path = path.with_suffix(".npy")
    _save_array(path, image)
    return f"saved {path.name} in place of a PNG, which needs OpenCV or matplotlib: pip install 'eal-actors[sim]'"


def _save_array(path: Path, array: Any) -> None:
    import numpy as np

    np.save(path, array, allow_pickle=False)


def _save_text(path: Path, text: str) -> None:
    _refuse_image_name(path)
    path.write_text(text, encoding="utf-8")


def _refuse_image_name(path: Path) -> None:
    if path.suffix in (".png", ".npy"):
        raise ScenarioError(
            f"{path.name} cannot hold this value: it is no {'image' if path.suffix == '.png' else 'array'}"
        )
