"""The pictures of cameras above the floor: perspective, lens distortion, blur and noise.

Every sample of a picture is a ray. A ray descends, so it meets the highest surface first: a buffer of heights decides
which surface is visible. The room and its fixed things are drawn once; for each picture, only the surroundings of
robots and boxes are drawn again. Each pixel is the mean of `SAMPLES` x `SAMPLES` samples, so that edges are placed to a
fraction of a pixel. A long exposure is the mean of several instants.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from eal_actors.device.world import OverheadCamera
from eal_actors.plugin import FAMILIES, FamilyName

from .eye import PinholeLens
from .movers import Mover
from .scene import Scene
from .solids import Block, Drum, Plane, Point, Tower
from .texture import Image, Mipmap

Array: TypeAlias = NDArray[np.float32]
Window: TypeAlias = tuple[slice, slice]

SAMPLES: Final = 2
_CELL_PX: Final = 8
"""Of the grid on which the lens is undistorted exactly. In between, rays are linear: the error is 0.005 pixels."""
_STEEPEST: Final = 50.0  # m along the floor per m of descent: a level ray meets a wall instead
_WALL: Final = (120, 120, 118)
_SIDE_SHARE: Final = 0.7  # brightness of upright surfaces
_MARGIN_PX: Final = 3
_NOISE_SPARE_PX: Final = 64
_TEXTURE_CELL: Final = 16  # samples of a marker's square
_BORDER: Final = 1  # white squares around a marker


@dataclass(frozen=True)
class MarkerPlate:
    """A printed marker in a world, face up, on a white plate.

    Attributes:
        size_m: side of its black square.
        x_m: its centre.
        y_m: its centre.
        z_m: its height over the floor.
        yaw_rad: direction from the left edge of the print to the right one.
    """

    family: FamilyName
    number: int
    size_m: float
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float

    @property
    def side_m(self) -> float:
        """Side of the plate."""
        cells = FAMILIES[self.family].cells
        return self.size_m * (cells + 2 * _BORDER) / cells


@dataclass(frozen=True)
class Instant:
    """The moving things at one instant."""

    movers: Sequence[Mover]
    plates: Sequence[MarkerPlate]


@cache
def plate_image(family: FamilyName, number: int) -> Image:
    """Return the picture of a plate, (rows, columns, 3)."""
    kind = FAMILIES[family]
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, kind.dictionary))
    marker = cv2.aruco.generateImageMarker(dictionary, number, kind.cells * _TEXTURE_CELL)
    edge = (_BORDER * _TEXTURE_CELL,) * 4
    plate = cv2.copyMakeBorder(marker, *edge, cv2.BORDER_CONSTANT, value=255)
    return np.repeat((25 + plate * (215 / 255)).astype(np.uint8)[..., np.newaxis], 3, axis=2)


class OverheadLens:
    """The projection of a camera above the floor.

    Attributes:
        matrix: the camera matrix, (3, 3).
        distortion: k1, k2, p1, p2, k3.
        rotation: from the camera's axes (right, down, ahead) to the world's, (3, 3).
        centre_m: the camera's place, (3,).
    """

    def __init__(self, camera: OverheadCamera) -> None:
        self.size = camera.width, camera.height
        self.matrix = PinholeLens(camera.width, camera.height, camera.fov_deg).matrix
        self.distortion = np.array(camera.distortion)
        yaw_rad, tilt_rad = math.radians(camera.yaw_deg), math.radians(camera.tilt_deg)
        up = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
        right = np.array([up[1], -up[0], 0.0])
        ahead = math.sin(tilt_rad) * up - math.cos(tilt_rad) * np.array([0.0, 0.0, 1.0])
        self.rotation = np.stack([right, np.cross(ahead, right), ahead], axis=1)
        self.centre_m = np.array([camera.x_m, camera.y_m, camera.z_m])

    def project(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pixels of points of the world, (n, 2) for (n, 3)."""
        turn, _ = cv2.Rodrigues(self.rotation.T)
        shift = -self.rotation.T @ self.centre_m
        pixels, _ = cv2.projectPoints(points, turn, shift, self.matrix, self.distortion)
        return np.asarray(pixels, np.float64).reshape(-1, 2)

    def slopes(self) -> tuple[Array, Array]:
        """Return how far each sample's ray goes along x and y for each metre of descent."""
        columns, rows = (math.ceil(size / _CELL_PX) + 2 for size in self.size)
        at_x, at_y = np.meshgrid(
            *((np.arange(count) - 0.5) * _CELL_PX - 0.5 for count in (columns, rows))
        )  # the cells' middles
        pixels = np.stack([at_x, at_y], axis=-1).reshape(-1, 1, 2)
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 60, 1e-9)
        rays = cv2.undistortPoints(pixels, self.matrix, self.distortion, criteria=stop).reshape(-1, 2)
        world = np.column_stack([rays, np.ones(len(rays))]) @ self.rotation.T
        falls = np.maximum(-world[:, 2], 1 / _STEEPEST)
        found = []
        width, height = (size * SAMPLES for size in self.size)
        for axis in range(2):
            coarse = (world[:, axis] / falls).astype(np.float32).reshape(rows, columns)
            factor = _CELL_PX * SAMPLES
            fine = cv2.resize(coarse, (columns * factor, rows * factor), interpolation=cv2.INTER_LINEAR)
            found.append(np.ascontiguousarray(fine[factor : factor + height, factor : factor + width]))
        return found[0], found[1]


class OverheadRenderer:
    """Draws what a camera above the floor sees.

    Thread: one at a time.
    """

    def __init__(self, scene: Scene, camera: OverheadCamera, plates: Sequence[MarkerPlate]) -> None:
        self._scene = scene
        self._camera = camera
        self.lens: Final = OverheadLens(camera)
        self._slopes = self.lens.slopes()
        rows, columns = self._slopes[0].shape
        self._colours = np.empty((rows, columns, 3), np.uint8)
        self._heights = np.zeros((rows, columns), np.float32)
        self._draw_room()
        for tower in scene.towers:
            self._draw_tower(tower)
        for block in scene.blocks:
            self._draw_block(block)
        for plate in plates:
            self._draw_plate(plate)
        self._still_colours, self._still_heights = self._colours.copy(), self._heights.copy()
        self._still = _averaged(self._colours)
        noise = np.random.default_rng(0).normal(
            0, camera.noise, (camera.height + _NOISE_SPARE_PX, camera.width + _NOISE_SPARE_PX, 3)
        )
        self._noise = np.rint(noise).astype(np.int16)

    def picture(self, instants: Sequence[Instant], seed: int) -> NDArray[np.uint8]:
        """Return the picture, (height, width, 3): blue, green and red, rows from the top.

        It is the mean of what is to be seen at the instants, which are at equal distances of time over the exposure.
        """
        image = self._sharp(instants[0])
        if len(instants) > 1:
            total = image.astype(np.uint16)
            for instant in instants[1:]:
                total += self._sharp(instant)
            image = ((total + len(instants) // 2) // len(instants)).astype(np.uint8)
        if self._camera.blur_px:
            image = np.asarray(cv2.GaussianBlur(image, (0, 0), self._camera.blur_px), np.uint8)
        if self._camera.noise:
            top, left = np.random.default_rng(seed).integers(_NOISE_SPARE_PX, size=2)
            height, width = image.shape[:2]
            image = cv2.add(image, self._noise[top : top + height, left : left + width], dtype=cv2.CV_8U)  # type: ignore[assignment]
        return image

    def _sharp(self, instant: Instant) -> NDArray[np.uint8]:
        """Return the picture of one instant, without blur and noise."""
        image = self._still.copy()
        solids, _ = self._scene.placed(instant.movers)
        drawn: list[Window] = []
        for solid in solids:
            drawn += self._draw_tower(solid) if isinstance(solid, Tower) else self._draw_block(solid)
        for plate in instant.plates:
            drawn += self._draw_plate(plate)
        for rows, columns in drawn:
            pixels = (
                slice(rows.start // SAMPLES, rows.stop // SAMPLES),
                slice(columns.start // SAMPLES, columns.stop // SAMPLES),
            )
            image[pixels] = _averaged(self._colours[rows, columns])
        for window in drawn:
            self._colours[window], self._heights[window] = self._still_colours[window], self._still_heights[window]
        return image

    def _draw_room(self) -> None:
        """Draw the floor, and plain walls where a ray leaves the room."""
        floor = self._scene.floor
        half_x_m, half_y_m = (size_m / 2 for size_m in floor.texture.size_m)
        rows, columns = self._heights.shape
        for top in range(0, rows, 256):  # in strips, to save memory
            window = (slice(top, min(top + 256, rows)), slice(0, columns))
            x_m, y_m = self._at(window, 0.0)
            self._colours[window] = _sampled(floor, x_m, y_m)
            self._colours[window][(np.abs(x_m) > half_x_m) | (np.abs(y_m) > half_y_m)] = _WALL

    def _draw_tower(self, tower: Tower) -> list[Window]:
        windows = []
        for drum in tower.drums:
            (x_m, y_m), reach_m = drum.middle, drum.radius_m
            corners = [(x_m + x * reach_m, y_m + y * reach_m) for x in (-1, 1) for y in (-1, 1)]
            for window in self._window(corners, (drum.bottom_m, drum.height_m)):
                self._draw_side(window, drum)
                windows.append(window)
            for window in self._window(corners, (drum.height_m,)):
                top_x, top_y = self._at(window, drum.height_m)
                is_hit = (top_x - x_m) ** 2 + (top_y - y_m) ** 2 <= reach_m**2
                self._put(window, is_hit, drum.height_m, _sampled(drum.top, top_x, top_y))
        return windows

    def _draw_side(self, window: Window, drum: Drum) -> None:
        """Draw the side of a drum, which a ray meets below the height of its top."""
        x_m, y_m = self._at(window, drum.height_m)
        x_m, y_m = x_m - np.float32(drum.middle[0]), y_m - np.float32(drum.middle[1])
        slope_x, slope_y = (slopes[window] for slopes in self._slopes)
        per_m2 = np.maximum(slope_x * slope_x + slope_y * slope_y, np.float32(1e-9))
        towards = x_m * slope_x + y_m * slope_y
        root = towards * towards - per_m2 * (x_m * x_m + y_m * y_m - np.float32(drum.radius_m**2))
        fall_m = np.asarray((-towards - np.sqrt(np.maximum(root, 0))) / per_m2, np.float32)
        is_hit = (root > 0) & (fall_m > 0) & (fall_m < drum.height_m - drum.bottom_m)
        self._put(window, is_hit, np.float32(drum.height_m) - fall_m, _side_colour(drum.side, drum.gains))

    def _draw_block(self, block: Block) -> list[Window]:
        windows = list(self._window(block.corners, (0.0, block.height_m)))
        for window in windows:
            x_m, y_m = self._at(window, block.height_m)
            slope_x, slope_y = (slopes[window] for slopes in self._slopes)
            enter_m, leave_m = np.zeros_like(x_m), np.full_like(x_m, block.height_m)
            for (x0, y0), (x1, y1) in zip(block.corners, block.corners[1:] + block.corners[:1], strict=True):
                outside = (y1 - y0) * (x_m - x0) - (x1 - x0) * (y_m - y0)  # over 0 on the right of a corner's way
                speed = (y1 - y0) * slope_x - (x1 - x0) * slope_y
                with np.errstate(divide="ignore", invalid="ignore"):
                    meets_m = -outside / speed
                enter_m = np.where(speed < 0, np.maximum(enter_m, meets_m), enter_m)
                leave_m = np.where(speed > 0, np.minimum(leave_m, meets_m), leave_m)
                leave_m = np.where((speed == 0) & (outside > 0), -1.0, leave_m)
            is_hit = enter_m < leave_m
            self._put(window, is_hit & (enter_m > 0), block.height_m - enter_m, _side_colour(block.top.texture, None))
            self._put(window, is_hit & (enter_m <= 0), block.height_m, _sampled(block.top, x_m, y_m))
        return windows

    def _draw_plate(self, plate: MarkerPlate) -> list[Window]:
        half_m = plate.side_m / 2
        cos, sin = math.cos(plate.yaw_rad), math.sin(plate.yaw_rad)
        corners = [
            (plate.x_m + half_m * (cos * x - sin * y), plate.y_m + half_m * (sin * x + cos * y))
            for x in (-1, 1)
            for y in (-1, 1)
        ]
        windows = list(self._window(corners, (plate.z_m,)))
        image = plate_image(plate.family, plate.number)
        per_m = image.shape[0] / plate.side_m
        for window in windows:
            x_m, y_m = self._at(window, plate.z_m)
            x_m, y_m = x_m - plate.x_m, y_m - plate.y_m
            along_m, up_m = cos * x_m + sin * y_m, cos * y_m - sin * x_m
            columns, rows = (along_m + half_m) * per_m - 0.5, (half_m - up_m) * per_m - 0.5
            colours = cv2.remap(image, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            is_hit = (np.abs(along_m) <= half_m) & (np.abs(up_m) <= half_m)
            self._put(window, is_hit, plate.z_m, np.asarray(colours, np.uint8))
        return windows

    def _at(self, window: Window, height_m: float) -> tuple[Array, Array]:
        """Return where the rays of a window are at a height."""
        fall_m = np.float32(self.lens.centre_m[2] - height_m)
        x_m, y_m = (self._slopes[axis][window] * fall_m + np.float32(self.lens.centre_m[axis]) for axis in range(2))
        return x_m, y_m

    def _put(self, window: Window, is_hit: NDArray[np.bool_], height_m: Array | float, colours: Image) -> None:
        """Draw the samples of a surface that are not hidden by something higher, where `is_hit` in the window.

        Heights over the floor and colours are of each sample, or one for all.
        """
        heights_m, mask = self._heights[window], (is_hit & (height_m > self._heights[window])).astype(np.uint8)
        cv2.copyTo(np.full(mask.shape, height_m, np.float32), mask, heights_m)
        target = self._colours[window]
        if colours.ndim == 3:
            cv2.copyTo(colours, mask, target)
        else:
            cv2.subtract(target, target, target, mask)
            cv2.add(target, np.array([*colours, 0], np.float64), target, mask)

    def _window(self, corners: Iterable[Point], heights_m: Sequence[float]) -> Iterator[Window]:
        """Yield the whole pixels in which an upright prism may be seen; nothing if it is out of sight."""
        top_m = float(self.lens.centre_m[2]) - 0.01
        points = np.array([(x_m, y_m, min(z_m, top_m)) for x_m, y_m in corners for z_m in heights_m])
        ahead = (points - self.lens.centre_m) @ self.lens.rotation[:, 2]
        if (ahead <= 0.01).any():
            return
        pixels = self.lens.project(points)
        margin_px = _MARGIN_PX + 0.05 * np.ptp(pixels, axis=0)  # a lens bends straight edges outwards
        first = np.floor(pixels.min(axis=0) - margin_px).astype(int)
        last = np.ceil(pixels.max(axis=0) + margin_px).astype(int)
        (left, top), (right, bottom) = np.maximum(first, 0), np.minimum(last, self.lens.size)
        if left < right and top < bottom:
            yield slice(top * SAMPLES, bottom * SAMPLES), slice(left * SAMPLES, right * SAMPLES)


def _averaged(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return blue, green and red pixels of red, green and blue samples."""
    rows, columns = colours.shape[:2]
    small = cv2.resize(colours, (columns // SAMPLES, rows // SAMPLES), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(small, cv2.COLOR_RGB2BGR), np.uint8)


def _sampled(plane: Plane, x_m: Array, y_m: Array) -> Image:
    """Return the colours of a level surface at some places, (rows, columns, 3)."""
    (width_m, height_m), (per_x, per_y) = plane.texture.size_m, plane.texture.per_m
    x_m, y_m = x_m - np.float32(plane.middle[0]), y_m - np.float32(plane.middle[1])
    cos, sin = np.float32(math.cos(plane.yaw_rad)), np.float32(math.sin(plane.yaw_rad))
    columns = (cos * x_m + sin * y_m + np.float32(width_m / 2)) * np.float32(per_x)
    rows = (np.float32(height_m / 2) - (cos * y_m - sin * x_m)) * np.float32(per_y)
    texture = plane.texture.finest
    colours = cv2.remap(texture, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = cv2.cvtColor(colours, cv2.COLOR_RGBA2RGB)
    return np.asarray(colours if plane.gain == 1.0 else cv2.convertScaleAbs(colours, alpha=plane.gain), np.uint8)


def _side_colour(texture: Mipmap, gains: NDArray[np.float64] | None) -> Image:
    """Return the one colour of an upright surface, red, green and blue."""
    gain = _SIDE_SHARE * (1.0 if gains is None else float(np.mean(gains)))
    return np.minimum(_mean_colour(texture) * gain, 255).astype(np.uint8)


@cache
def _mean_colour(texture: Mipmap) -> NDArray[np.float64]:
    return np.asarray(texture.finest[..., :3].mean(axis=(0, 1)))
