"""Map files of map_server and Nav2: cells by their documented rules, and errors with their places."""

from __future__ import annotations

import math
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from eal_actors.device.navigation.grid import MAX_CELLS, GridOrigin, OccupancyGrid
from eal_actors.device.navigation.map_file import load_map, save_map
from eal_actors.kernel.errors import ConfigError
from tests.problems import problem_texts

# As `ros2 run nav2_map_server map_saver_cli` writes it, except for the name of the picture.
NAV2 = """\
image: floor.pgm
mode: trinary
resolution: 0.05
origin: [-1.2, -3.4, 0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.25
"""
# As map_saver of ROS 1 writes it.
ROS1 = """\
image: floor.pgm
resolution: 0.050000
origin: [-10.000000, -10.000000, 0.000000]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196

"""
PLAIN_PGM = b"P2\n# drawn by hand\n4 2\n255\n0 254 205 100\n254 254 0 205\n"


def write(folder: Path, text: str, picture: bytes = PLAIN_PGM, name: str = "floor.pgm") -> Path:
    (folder / name).write_bytes(picture)
    file = folder / "floor.yaml"
    file.write_text(text, encoding="utf-8")
    return file


def write_png(folder: Path, text: str, pixels: object, mode: str) -> Path:
    Image.fromarray(np.array(pixels, np.uint8), mode=mode).save(folder / "floor.png")
    file = folder / "floor.yaml"
    file.write_text(text.replace("floor.pgm", "floor.png"), encoding="utf-8")
    return file


def test_a_map_of_ros_1_has_unknown_grey(tmp_path: Path) -> None:
    grid = load_map(write(tmp_path, ROS1))
    assert grid.cells.tolist() == [[0, 0, 100, -1], [100, 0, -1, -1]]  # the lower row of the picture first
    assert (grid.resolution_m, grid.origin) == (0.05, (-10.0, -10.0, 0.0))


def test_a_map_of_nav2_takes_grey_205_as_free_by_its_own_threshold(tmp_path: Path) -> None:
    grid = load_map(write(tmp_path, NAV2))
    assert grid.cells.tolist() == [[0, 0, 100, 0], [100, 0, 0, -1]]
    assert grid.is_free(-1.2 + 0.01, -3.4 + 0.01)
    assert not grid.is_free(-1.2 + 0.01, -3.4 + 0.06)


def test_negate_makes_dark_pixels_free(tmp_path: Path) -> None:
    for flag in ("1", "true"):
        grid = load_map(write(tmp_path, ROS1.replace("negate: 0", f"negate: {flag}")))
        assert grid.cells.tolist() == [[100, 100, 0, 100], [0, 100, 100, -1]]


def test_scale_has_percents_between_the_thresholds_and_unknown_where_transparent(tmp_path: Path) -> None:
    text = ROS1.replace("0.65", "0.9").replace("0.196", "0.1") + "mode: scale\n"
    pixels = [[[0, 0, 0, 255], [255, 255, 255, 255], [102, 102, 102, 255], [255, 255, 255, 254]]]
    assert load_map(write_png(tmp_path, text, pixels, "RGBA")).cells.tolist() == [[100, 0, 62, -1]]


def test_raw_has_the_values_of_the_pixels(tmp_path: Path) -> None:
    text = ROS1 + "mode: raw\n"
    assert load_map(write_png(tmp_path, text, [[0, 42, 100, 101, 255]], "L")).cells.tolist() == [[0, 42, 100, -1, -1]]


def test_colours_are_averaged_and_trinary_averages_the_opacity_too(tmp_path: Path) -> None:
    red = [[[255, 0, 0], [0, 0, 0], [255, 255, 255]]]
    assert load_map(write_png(tmp_path, ROS1, red, "RGB")).cells.tolist() == [[100, 100, 0]]
    clear = [[[0, 0, 0, 255], [0, 0, 0, 0], [255, 255, 255, 0], [255, 255, 255, 255]]]
    assert load_map(write_png(tmp_path, ROS1, clear, "RGBA")).cells.tolist() == [[100, 100, -1, 0]]


def test_sixteen_bits_are_read(tmp_path: Path) -> None:
    pgm = b"P5 3 1 65535\n" + np.array([0, 52685, 65535], ">u2").tobytes()
    assert load_map(write(tmp_path, ROS1, pgm)).cells.tolist() == [[100, -1, 0]]


def test_a_turned_map_has_its_cells_in_the_map_frame(tmp_path: Path) -> None:
    text = ROS1.replace("[-10.000000, -10.000000, 0.000000]", f"[1, 2, {math.pi / 2}]")
    grid = load_map(write(tmp_path, text))
    assert not grid.is_free(1 - 0.075, 2 + 0.025)  # upper left pixel: one row up is one to the left
    assert grid.is_free(1 - 0.075, 2 + 0.075)


def test_a_saved_map_is_read_back_the_same(tmp_path: Path) -> None:
    cells = np.array([[0, 100, -1, 0, 0], [0, 0, 0, -1, 100]], np.int8)
    grid = OccupancyGrid(cells, 0.025, GridOrigin(-1.5, 0.1, 0.3))
    written, picture = save_map(grid, tmp_path / "floor.yaml")
    again = load_map(written)
    assert picture.name == "floor.pgm"
    assert again.cells.tolist() == cells.tolist()
    assert (again.resolution_m, again.origin) == (0.025, (-1.5, 0.1, 0.3))
    with Image.open(picture) as image:  # another reader of PGM
        assert np.asarray(image).tolist() == [[254, 254, 254, 205, 0], [254, 0, 205, 254, 254]]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (NAV2.replace("resolution: 0.05\n", ""), ["floor.yaml:1:1: resolution: is missing"]),
        (NAV2.replace("0.05", "-1"), ["floor.yaml:3:13: resolution: must be at least 0.0001, not -1"]),
        (NAV2.replace("0.05", "1e-300"), ["floor.yaml:3:13: resolution: must be at least 0.0001, not 1e-300"]),
        (NAV2.replace("-3.4", "1e308"), ["floor.yaml:4:16: origin[1]: must be at most 1000000, not 1e+308"]),
        (NAV2.replace("0.05", ".nan"), ["floor.yaml:3:13: resolution: .nan is not a finite number"]),
        (NAV2.replace("-3.4, 0]", "-3.4]"), ["floor.yaml:4:9: origin[2]: is missing"]),
        (NAV2.replace("mode: trinary", "mode: trinery"), ["floor.yaml:2:7: mode: must be 'trinary', 'scale' or 'raw'"]),
        (NAV2.replace("negate: 0", "negate: 2"), ["floor.yaml:5:9: negate: must be 0 or 1, not 2"]),
        (NAV2.replace("0.65", "65"), ["floor.yaml:6:18: occupied_thresh: must be at most 1, not 65"]),
        (NAV2.replace("0.25", "0.7"), ["floor.yaml:1:1: free_thresh 0.7 must be under occupied_thresh 0.65"]),
        (
            NAV2 + "resolutoin: 1\n",
            ["floor.yaml:8:1: resolutoin: unknown key 'resolutoin'; did you mean 'resolution'?"],
        ),
        (
            NAV2.replace("floor.pgm", "flor.pgm"),
            ["floor.yaml:1:8: image: no such file: flor.pgm; did you mean 'floor.pgm'?"],
        ),
        ("image: [\n", ["floor.yaml:2:1: not valid YAML"]),
    ],
)
def test_errors_have_places(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, expected: list[str]) -> None:
    monkeypatch.chdir(write(tmp_path, text).parent)
    found = problem_texts(lambda: load_map("floor.yaml"))
    assert len(found) == len(expected)
    assert all(message.startswith(start) for message, start in zip(found, expected, strict=True)), found


@pytest.mark.parametrize(
    ("picture", "message"),
    [
        (b"not a picture at all", "is no picture; PGM, PNG, BMP and JPEG are"),
        (b"P5\n40 40\n255\n12", "cannot be read: "),
        (b"P5\n5000 5000\n255\n", f"has 5000 x 5000 pixels; at most {MAX_CELLS:,} are allowed"),
        (b"", "is no picture"),
    ],
)
def test_a_broken_picture_is_an_error_at_its_name(tmp_path: Path, picture: bytes, message: str) -> None:
    with pytest.raises(ConfigError, match=f"floor.yaml:1:8: image: .*floor.pgm {message}"):
        load_map(write(tmp_path, NAV2, picture))


@pytest.mark.parametrize("kind", ["EPS", "TIFF"])
def test_no_other_decoder_is_run(kind: str, tmp_path: Path) -> None:
    """Pillow hands PostScript, whatever the file is called, to the program Ghostscript."""
    file = write(tmp_path, NAV2)
    Image.new("RGB", (4, 2)).save(tmp_path / "floor.pgm", format=kind)
    with pytest.raises(ConfigError, match="is no picture; PGM, PNG, BMP and JPEG are"):
        load_map(file)


@pytest.mark.parametrize("mode", ["1", "L", "RGBA", "I;16"])
def test_a_small_file_with_many_pixels_takes_little_memory(mode: str, tmp_path: Path) -> None:
    side = 2000
    file = write(tmp_path, NAV2.replace("floor.pgm", "floor.png"))
    Image.new(mode, (side, side)).save(tmp_path / "floor.png")
    assert (tmp_path / "floor.png").stat().st_size < 40_000
    tracemalloc.start()
    try:
        load_map(file)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 24 * side**2, "of 16 million pixels a map takes less than 400 MB"


def test_a_pipe_in_place_of_a_picture_is_refused(tmp_path: Path) -> None:
    """Its reader waited for a writer without end."""
    file = write(tmp_path, NAV2)
    (file.parent / "floor.pgm").unlink(missing_ok=True)
    os.mkfifo(file.parent / "floor.pgm")
    with pytest.raises(ConfigError, match=r"floor\.pgm is no file"):
        load_map(file)
