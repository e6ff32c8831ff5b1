"""Map files of ROS's map_server and Nav2: a YAML file that names a picture, whose pixels are cells.

Source: docs.ros.org, packages map_server and nav2_map_server. Bright pixels are free, dark ones are occupied.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, PositiveFloat, model_validator

from eal_actors.device.navigation.grid import FREE, MAX_CELLS, OCCUPIED, UNKNOWN, GridOrigin, OccupancyGrid
from eal_actors.kernel.errors import ConfigError, UnsupportedError
from eal_actors.kernel.strict_model import StrictModel, model_of
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.kernel.yaml_tree import YamlTree, show

Shades = NDArray[np.float64]
"""Brightness or opacity of pixels, from 0 to 1."""

_FORMATS: Final = ("PPM", "PNG", "BMP", "JPEG")
"""The only decoders of Pillow that see the file: another one runs PostScript."""
_BAND: Final = 2**19  # pixels that are worked on at a time
_FREE_SHADE: Final = 254
_UNKNOWN_SHADE: Final = 205  # the greys that map_saver writes; with `_FREE_THRESH`, 205 is unknown to every reader
_FREE_THRESH: Final = 0.196
_OCCUPIED_THRESH: Final = 0.65
_MOST_PERCENT: Final = 100


def _flag(value: object) -> object:
    if value in (0, 1):  # also False and True: map_server takes both
        return bool(value)
    raise ValueError(f"must be 0 or 1, not {show(value)}")


Fraction = Annotated[float, Field(ge=0, le=1)]

Coordinate = Annotated[float, Field(ge=-1e6, le=1e6)]


class MapFile(StrictModel):
    """The YAML file of a map."""

    image: Annotated[str, Field(min_length=1)]
    """The picture: PGM, PNG, BMP or JPEG; relative to this file."""
    resolution: Annotated[PositiveFloat, Field(ge=1e-4, le=1e4)]
    """Metres for each pixel."""
    origin: tuple[Coordinate, Coordinate, Coordinate] = Field(strict=False)
    """Pose of the lower left corner of the picture: x and y in m, yaw in rad."""
    negate: Annotated[bool, BeforeValidator(_flag)] = False
    """Whether dark pixels are free; `raw` ignores it."""
    occupied_thresh: Fraction
    """A pixel with a higher probability is occupied."""
    free_thresh: Fraction
    """A pixel with a lower probability is free."""
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    """`trinary`: occupied, free or unknown. `scale`: percent between the thresholds, unknown where transparent. `raw`:
    the values of the pixels from 0 to 100 are percent, all others unknown."""

    @model_validator(mode="after")
    def _has_order(self) -> Self:
        if self.free_thresh >= self.occupied_thresh:
            raise ValueError(f"free_thresh {self.free_thresh:g} must be under occupied_thresh {self.occupied_thresh:g}")
        return self


def load_map(path: str | Path) -> OccupancyGrid:
    """Load a map file and its picture.

    Raises:
        ConfigError: with every problem of the file, or that of its picture.
        UnsupportedError: Pillow is not installed.
    """
    tree = load_yaml(Path(path))
    settings = model_of(MapFile, tree)
    size, pixels, has_alpha = _picture(tree, Path(path).parent / settings.image)
    bands = np.array_split(pixels, math.ceil(len(pixels) / _BAND))  # real numbers of all would take a gigabyte
    cells = np.concatenate([_cells(settings, *_shades(band, has_alpha=has_alpha)) for band in bands])
    cells = np.flipud(cells.reshape(size))  # the first row of a picture is its upper one
    return OccupancyGrid(np.ascontiguousarray(cells), settings.resolution, GridOrigin(*settings.origin))


def save_map(grid: OccupancyGrid, path: Path) -> tuple[Path, Path]:
    """Write a trinary map file, and a PGM picture of the same name, for Nav2 and map_server; return both.

    Raises OSError if they cannot be written.
    """
    shades = np.full(grid.cells.shape, _FREE_SHADE, np.uint8)
    shades[grid.blocked] = 0
    shades[grid.cells == UNKNOWN] = _UNKNOWN_SHADE
    rows, columns = grid.cells.shape
    picture = path.with_suffix(".pgm")
    header = f"P5\n# {grid.resolution_m:.6g} m/pix\n{columns} {rows}\n255\n"
    picture.write_bytes(header.encode("ascii") + np.flipud(shades).tobytes())
    settings = {
        "image": picture.name,
        "mode": "trinary",
        "resolution": float(grid.resolution_m),
        "origin": [float(number) for number in grid.origin],
        "negate": 0,
        "occupied_thresh": _OCCUPIED_THRESH,
        "free_thresh": _FREE_THRESH,
    }
    path.write_text(yaml.safe_dump(settings, sort_keys=False, default_flow_style=None), encoding="utf-8")
    return path, picture


def _cells(settings: MapFile, shades: Shades, alphas: Shades | None) -> NDArray[np.int8]:
    """Return the cells of a picture's pixels, in its order."""
    if settings.mode == "raw":
        values = np.rint(shades * 255)
        return np.where(values <= _MOST_PERCENT, values, UNKNOWN).astype(np.int8)
    if settings.mode == "trinary" and alphas is not None:
        shades = (3 * shades + alphas) / 4  # as map_server does, which takes the opacity for a fourth colour
    probability = shades if settings.negate else 1 - shades
    span = settings.occupied_thresh - settings.free_thresh
    between = np.rint((probability - settings.free_thresh) / span * 100) if settings.mode == "scale" else UNKNOWN
    cells = np.where(probability < settings.free_thresh, FREE, between)
    cells = np.where(probability > settings.occupied_thresh, OCCUPIED, cells)
    if settings.mode == "scale" and alphas is not None:
        cells = np.where(alphas < 1, UNKNOWN, cells)
    return cells.astype(np.int8)


def _shades(pixels: NDArray[Any], *, has_alpha: bool) -> tuple[Shades, Shades | None]:
    """Return brightness and opacity of pixels, or None for the opacity of those without."""
    if pixels.ndim == 1:
        return pixels / 65535, None
    parts = pixels / 255
    return parts[:, :3].mean(axis=1), parts[:, 3] if has_alpha else None


def _picture(tree: YamlTree, path: Path) -> tuple[tuple[int, int], NDArray[Any], bool]:
    """Return the rows and columns of a picture, its pixels of 16 bits or of RGBA, and whether they have an opacity."""
    try:
        from PIL import Image, UnidentifiedImageError
    except ImportError as error:
        raise UnsupportedError("maps of pictures need Pillow: pip install 'eal-actors[sim]'") from error
    if path.exists() and not path.is_file():  # a pipe, which would wait for its writer
        raise _problem(tree, f"{path} is no file")
    try:
        with Image.open(path, formats=_FORMATS) as picture:
            if math.prod(picture.size) > MAX_CELLS:
                size = f"{picture.width} x {picture.height} pixels"
                raise _problem(tree, f"{path} has {size}; at most {MAX_CELLS:,} are allowed")
            rows_columns = picture.height, picture.width
            if picture.mode.startswith("I"):
                return rows_columns, np.asarray(picture).ravel(), False
            has_alpha = picture.has_transparency_data
            return rows_columns, np.asarray(picture.convert("RGBA")).reshape(-1, 4), has_alpha
    except FileNotFoundError:
        near = [file.name for file in path.parent.glob("*") if file.suffix in (".pgm", ".png", ".bmp", ".jpg", ".jpeg")]
        raise _problem(tree, f"no such file: {path}{did_you_mean(path.name, near)}") from None
    except UnidentifiedImageError:
        raise _problem(tree, f"{path} is no picture; PGM, PNG, BMP and JPEG are") from None
    except (OSError, ValueError, SyntaxError, MemoryError, Image.DecompressionBombError) as error:
        raise _problem(tree, f"{path} cannot be read: {str(error) or type(error).__name__}") from error


def _problem(tree: YamlTree, message: str) -> ConfigError:
    return ConfigError([tree.problem(("image",), message)])
