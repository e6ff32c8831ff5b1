"""Sheets as pixels, and pictures of a board through a lens, by OpenCV alone."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
import zlib
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.markers.prints import BoardSize

SIZE = 640, 480
MATRIX = np.array([[512.0, 0, 324.0], [0, 512.0, 237.0], [0, 0, 1]])
DISTORTION = np.array([-0.2, 0.05, 0.001, -0.0005, 0.0])
PER_MM = 8
_PER_M, _EDGE = 3000, 60
"""Of the texture of a board: pixels in a metre, and of its white edge."""


def svg_pixels(text: str) -> NDArray[np.uint8]:
    """Return an SVG sheet as grey pixels, 8 in a millimetre."""
    root = ET.fromstring(text)  # noqa: S314  # written by the test's own process
    width_mm, height_mm = (float(str(root.get(key)).removesuffix("mm")) for key in ("width", "height"))
    group = root.find("{http://www.w3.org/2000/svg}g")
    assert group is not None
    boxes = [[float(str(one.get(key))) for key in ("x", "y", "width", "height")] for one in group]
    return _pixels(width_mm, height_mm, boxes)


def pdf_pixels(data: bytes, page: int = 0) -> NDArray[np.uint8]:
    """Return a page of a PDF file as grey pixels, 8 in a millimetre."""
    width_mm, height_mm = (
        float(part) * 25.4 / 72 for part in re.findall(rb"MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", data)[page]
    )
    stream = re.findall(rb"stream\n(.*?)\nendstream", data, re.DOTALL)[page]
    content = zlib.decompress(stream).decode("latin-1")
    boxes = []
    for line in re.findall(r"^([\d. ]+) re$", content, re.MULTILINE):
        x, y, width, height = map(float, line.split())
        boxes.append([x, height_mm - y - height, width, height])
    return _pixels(width_mm, height_mm, boxes)


def _pixels(width_mm: float, height_mm: float, boxes: list[list[float]]) -> NDArray[np.uint8]:
    image = np.full((round(height_mm * PER_MM), round(width_mm * PER_MM)), 255, np.uint8)
    for x, y, width, height in boxes:
        rows, columns = ((round(at * PER_MM), round((at + size) * PER_MM)) for at, size in ((y, height), (x, width)))
        image[slice(*rows), slice(*columns)] = 0
    return image


def board_picture(size: BoardSize, seed: int) -> NDArray[np.uint8]:
    """Return a picture of a board at a random pose: OpenCV's own drawing, projection and distortion."""
    generator = np.random.default_rng(seed)
    turn, _ = cv2.Rodrigues(np.append(generator.uniform(-0.6, 0.6, 2), generator.uniform(-0.4, 0.4)))
    middle = np.array([size.columns, size.rows, 0]) * size.square_m / 2
    ahead_m = generator.uniform(0.3, 0.5)
    place = np.append(generator.uniform((-0.5, -0.38), (0.5, 0.38)) * ahead_m * 0.7, ahead_m) - turn @ middle
    inverse = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], place]))
    to_texture = np.array([[_PER_M, 0, _EDGE - 0.5], [0, _PER_M, _EDGE - 0.5], [0, 0, 1]])
    pixels = cv2.perspectiveTransform(_rays(), to_texture @ inverse)
    fine = cv2.remap(_texture(size), pixels, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)  # type: ignore[call-overload]
    small = cv2.GaussianBlur(cv2.resize(fine, SIZE, interpolation=cv2.INTER_AREA), (0, 0), 0.6)
    noisy = small * 0.8 + 20 + generator.normal(0, 2, small.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


@cache
def _texture(size: BoardSize) -> NDArray[np.uint8]:
    columns, rows = round(size.columns * size.square_m * _PER_M), round(size.rows * size.square_m * _PER_M)
    image = size.board().generateImage((columns, rows))
    return np.asarray(cv2.copyMakeBorder(image, *(_EDGE,) * 4, cv2.BORDER_CONSTANT, value=255), np.uint8)


@cache
def _rays() -> NDArray[np.float32]:
    """Return the ray of each quarter of a pixel, (rows, columns, 2)."""
    grid = np.stack(np.meshgrid(np.arange(0, SIZE[0], 0.5), np.arange(0, SIZE[1], 0.5)), axis=-1) - 0.25
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 20, 1e-7)
    rays = cv2.undistortPoints(grid.reshape(-1, 1, 2), MATRIX, DISTORTION, criteria=stop)
    return np.asarray(rays, np.float32).reshape(SIZE[1] * 2, SIZE[0] * 2, 2)
