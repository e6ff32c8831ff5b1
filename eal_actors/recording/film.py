"""Film of a run as an animated GIF: the arena from above, and the robots on their ways."""

from __future__ import annotations

import importlib.util
import math
from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Final

from eal_actors.device.world import CircleObstacle, WorldModel
from eal_actors.device.world.geometry import corners
from eal_actors.kernel.log import get_logger
from eal_actors.recording.picture import COLOURS
from eal_actors.recording.poses import PoseSample, index_at
from eal_actors.recording.run_folder import RunFolder, folder_errors

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

_FILM: Final = "trajectory.gif"
_LONGEST_PX: Final = 560
_SHARPNESS: Final = 2  # it is drawn so many times as large, because PIL draws without smooth edges
_MOST_FRAMES: Final = 140
_LEAST_PERIOD_S: Final = 0.1
_FRAME_MS: Final = 60
_LAST_FRAMES: Final = 25
_TRAIL_S: Final = 12.0
_RADIUS_M: Final = 0.17
_MARGIN_M: Final = 0.35
_HOLLOW: Final = 0.62
_ROOM, _GROUND, _THING, _INK = (255, 255, 255), (238, 238, 238), (200, 200, 200), (60, 60, 60)

_Rgb = tuple[int, int, int]
_Point = tuple[float, float]
_Bounds = tuple[float, float, float, float]


def film_run(run: RunFolder, world: WorldModel | None) -> Path | None:
    """Write `trajectory.gif` into the run's folder; raise ScenarioError if it cannot be written.

    Return it; None if no robot has a Pose, or Pillow is missing, which is logged.
    """
    paths = {name: path for name, path in run.paths.items() if path}
    if not paths:
        return None
    if importlib.util.find_spec("PIL") is None:
        get_logger().warning("no film: Pillow is missing", remedy="pip install 'eal-actors[sim]'")
        return None
    from PIL import Image

    stage = _Stage(paths, world)
    first, *others = map(stage.frame, stage.times_s())
    first = first.quantize(64, dither=Image.Dither.NONE)  # it shows all robots, so the others use its colours
    others = [frame.quantize(palette=first, dither=Image.Dither.NONE) for frame in others]
    out = run.path / _FILM
    with folder_errors(run.path):
        first.save(out, save_all=True, append_images=others, duration=_FRAME_MS, loop=0, optimize=True)
    return out


class _Stage:
    """The arena, scaled to the picture; without a world, the paths' surroundings. Each robot has a sample."""

    def __init__(self, paths: Mapping[str, Sequence[PoseSample]], world: WorldModel | None) -> None:
        self._paths = paths
        self._bounds = _bounds(paths, world)
        left_m, low_m, right_m, high_m = self._bounds
        self._per_m = _SHARPNESS * _LONGEST_PX / max(right_m - left_m, high_m - low_m)
        sides_m = right_m - left_m, high_m - low_m
        width, height = (max(_SHARPNESS, round(side_m * self._per_m)) for side_m in sides_m)  # a path may be straight
        self._size = width, height
        self._empty = self._arena(world)

    def times_s(self) -> Iterator[float]:
        """Yield the times of the frames; the last one stays for a while."""
        end_s = max(path[-1].time_s for path in self._paths.values())
        count = max(1, min(_MOST_FRAMES, math.ceil(end_s / _LEAST_PERIOD_S)))
        yield from (end_s * number / count for number in range(count))
        yield from [end_s] * _LAST_FRAMES

    def frame(self, time_s: float) -> Image:
        """Return the picture of a time since the run's start."""
        from PIL import Image, ImageDraw

        picture = self._empty.copy()
        draw = ImageDraw.Draw(picture)
        for number, path in enumerate(self._paths.values()):
            colour = COLOURS[number % len(COLOURS)]
            last = index_at(path, time_s)
            first = bisect_right(path, time_s - _TRAIL_S, hi=last, key=attrgetter("time_s"))
            trail = [self._pixel(sample.x_m, sample.y_m) for sample in path[first : last + 1]]
            draw.line(trail, fill=colour, width=2 * _SHARPNESS, joint="curve")
            self._draw_robot(draw, path[last], colour, is_hollow=number // len(COLOURS) % 2 == 1)
        draw.text((14 * _SHARPNESS, 10 * _SHARPNESS), f"{time_s:.1f} s", fill=_INK, font_size=15 * _SHARPNESS)
        size = self._size[0] // _SHARPNESS, self._size[1] // _SHARPNESS
        return picture.resize(size, Image.Resampling.BOX)

    def _arena(self, world: WorldModel | None) -> Image:
        from PIL import Image, ImageDraw

        picture = Image.new("RGB", self._size, _GROUND if world is not None else _ROOM)
        draw = ImageDraw.Draw(picture)
        if world is None:
            return picture
        half_x_m, half_y_m = (size_m / 2 for size_m in world.size_m)
        room = [self._pixel(-half_x_m, half_y_m), self._pixel(half_x_m, -half_y_m)]
        draw.rectangle(room, fill=_ROOM, outline=_INK, width=2 * _SHARPNESS)
        for thing in (*world.solid_obstacles, *world.boxes):
            if isinstance(thing, CircleObstacle):
                self._draw_disc(draw, (thing.x_m, thing.y_m), thing.radius_m, _THING)
            else:
                draw.polygon([self._pixel(*corner) for corner in corners(thing)], fill=_THING)
        return picture

    def _draw_robot(self, draw: ImageDraw, sample: PoseSample, colour: str, *, is_hollow: bool) -> None:
        """Draw a disc with its heading; a hollow one for robots after the first eight, which repeat their colours."""
        middle, nose_colour = (sample.x_m, sample.y_m), colour if is_hollow else _ROOM
        self._draw_disc(draw, middle, _RADIUS_M, colour)
        if is_hollow:
            self._draw_disc(draw, middle, _RADIUS_M * _HOLLOW, _ROOM)
        nose = sample.x_m + _RADIUS_M * math.cos(sample.yaw_rad), sample.y_m + _RADIUS_M * math.sin(sample.yaw_rad)
        draw.line([self._pixel(*middle), self._pixel(*nose)], fill=nose_colour, width=3 * _SHARPNESS)

    def _draw_disc(self, draw: ImageDraw, middle: tuple[float, float], radius_m: float, fill: str | _Rgb) -> None:
        column, row = self._pixel(*middle)
        reach = radius_m * self._per_m
        draw.ellipse((column - reach, row - reach, column + reach, row + reach), fill=fill)

    def _pixel(self, x_m: float, y_m: float) -> _Point:
        left_m, _, _, high_m = self._bounds
        return (x_m - left_m) * self._per_m, (high_m - y_m) * self._per_m


def _bounds(paths: Mapping[str, Sequence[PoseSample]], world: WorldModel | None) -> _Bounds:
    """Return the west, south, east and north edges of the picture."""
    if world is not None:
        half_x_m, half_y_m = (size_m / 2 + _MARGIN_M / 2 for size_m in world.size_m)
        return -half_x_m, -half_y_m, half_x_m, half_y_m
    xs, ys = zip(*((sample.x_m, sample.y_m) for path in paths.values() for sample in path), strict=True)
    return min(xs) - _MARGIN_M, min(ys) - _MARGIN_M, max(xs) + _MARGIN_M, max(ys) + _MARGIN_M
