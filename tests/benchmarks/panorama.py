"""Panoramas of frames with known faults, judged by a picture that is cast ray by ray.

    python -m tests.benchmarks.panorama [--width 640] [--seed 1] [--page docs/panorama.md]

The camera turns in the laboratory by steps of 45 degrees. It has 60 degrees of view, and its odometry is wrong by 2
degrees (standard deviation). The judge looks from the axis of rotation. Where the camera is beside it, a further row
shows what the frames can reach: the camera, the yaws and the distances of all things are the true ones. With a page,
the table is written into it.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from eal_actors.lab.panorama import Panorama, stitch, stitching
from eal_actors.lab.panorama.cylinder import Attitude, CameraLens
from eal_actors.lab.panorama.parallax import KNOTS, USUAL_NEARNESS, DepthMap, Parallax, TurnedCamera
from eal_actors.lab.panorama.placement import place_frames
from plugins.sim.camera.eye import Eye, PinholeLens
from plugins.sim.camera.movers import RobotAppearance, RobotAt
from plugins.sim.camera.render import render
from tests.benchmarks.page import machine, write_between
from tests.unit.lab.panorama import turning
from tests.unit.lab.panorama.turning import PLACE_M, VIEW_RAD, Image
from tests.unit.plugins.sim.ray_caster import psnr_db

_MARK: Final = "<!-- bench-panorama -->"
_HEADINGS: Final = ("case", "PSNR", "goal", "SSIM", "goal", "yaw error, rms")
_ALIKE: Final = 0.93  # the goal of the similarity (SSIM)
_ROBOT: Final = RobotAppearance(0.17, 0.5, (200, 60, 40), 0.5)
_AWAY_M: Final = 1.6
_BEHIND_RAD: Final = math.radians(22.5)
_ROWS, _COLUMNS = 60, 864  # of the map of true distances


@dataclass(frozen=True)
class Case:
    """Frames with a fault.

    Attributes:
        name: of the fault.
        goal_db: least peak signal-to-noise ratio; None if there is no goal.
        told_deg: the field of view that the stitcher receives; it is 60.
        k1: radial distortion of the lens.
        ahead_m: distance of the camera ahead of the axis.
        left_m: distance to the left of it.
        passes: whether a robot stands on each seam in the frame to the left of it alone.
        is_known: whether the stitcher is given the camera, the yaws and all distances: the limit is that of the frames.
    """

    name: str
    goal_db: float | None
    told_deg: float = 60.0
    k1: float = 0.0
    ahead_m: float = 0.0
    left_m: float = 0.0
    passes: bool = False
    is_known: bool = False

    def movers(self, yaw_rad: float) -> list[RobotAt]:
        """Return what moves in the frame of a yaw."""
        if not self.passes:
            return []
        seam_rad = yaw_rad - _BEHIND_RAD
        x_m, y_m = PLACE_M[0] + _AWAY_M * math.cos(seam_rad), PLACE_M[1] + _AWAY_M * math.sin(seam_rad)
        return [RobotAt(_ROBOT, x_m, y_m, 0.0)]

    def frame(self, yaw_rad: float, width: int) -> Image:
        """Return what the camera sees at a yaw."""
        lens = CameraLens(width, width * 3 // 4, VIEW_RAD)
        if not self.k1:
            return self._seen(yaw_rad, lens)
        x, y = ((np.arange(size) - (size - 1) / 2) / lens.focal_px for size in (lens.width, lens.height))
        far = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 1, 2)
        straight = cv2.undistortPoints(far, np.eye(3), np.array([self.k1, 0.0, 0.0, 0.0]))
        large = CameraLens(2 * lens.width, 2 * lens.height, 2 * math.atan(math.tan(VIEW_RAD / 2) * 1.4))
        middle = (large.width - 1) / 2, (large.height - 1) / 2
        maps = (straight.reshape(lens.height, lens.width, 2) * large.focal_px + middle).astype(np.float32)
        picture = self._seen(yaw_rad, large)
        return np.asarray(cv2.remap(picture, maps[..., 0], maps[..., 1], cv2.INTER_LANCZOS4), np.uint8)

    def _seen(self, yaw_rad: float, lens: CameraLens) -> Image:
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        x_m = PLACE_M[0] + self.ahead_m * cos - self.left_m * sin
        y_m = PLACE_M[1] + self.ahead_m * sin + self.left_m * cos
        pinhole = PinholeLens(lens.width, lens.height, math.degrees(lens.field_of_view_rad))
        return render(turning.lab(), self.movers(yaw_rad), Eye(x_m, y_m, PLACE_M[2], yaw_rad, pinhole))


CASES: Final = (
    Case("nothing wrong", 30),
    Case("field of view told 5 % too wide", 30, told_deg=63),
    Case("field of view told 5 % too narrow", 30, told_deg=57),
    Case("lens with k1 = -0.1", 30, k1=-0.1),
    Case("camera 8 cm ahead of the axis", 25, ahead_m=0.08),
    Case("camera 8 cm to the left of the axis", 25, left_m=0.08),
    Case("camera 8 cm ahead, all known", None, ahead_m=0.08, is_known=True),
    Case("camera 8 cm to the left, all known", None, left_m=0.08, is_known=True),
    Case("a robot that passes, on each of 8 seams", 25, passes=True),
)


def _truth(case: Case, panorama: Panorama, true_rad: Sequence[float]) -> Image:
    """Return the perfect panorama; where a robot passed, with or without it, as the panorama shows it there."""
    empty = turning.truth(panorama, true_rad)
    if not case.passes:
        return empty
    crowded = turning.truth(panorama, true_rad, movers=[robot for yaw in true_rad for robot in case.movers(yaw)])
    best, reach = empty.copy(), round(_BEHIND_RAD / 2 * panorama.px_per_rad)
    for yaw_rad in true_rad:
        turned_rad = panorama.left_yaw_rad - turning.mean_error_rad(panorama, true_rad) - yaw_rad + _BEHIND_RAD
        middle = round(turned_rad * panorama.px_per_rad)
        columns = np.arange(middle - reach, middle + reach) % empty.shape[1]
        here = panorama.image[:, columns]
        if psnr_db(here, crowded[:, columns]) > psnr_db(here, empty[:, columns]):
            best[:, columns] = crowded[:, columns]
    return best


def _stitch(case: Case, frames: Sequence[Image], true_rad: Sequence[float]) -> Panorama:
    if not case.is_known:
        return stitch(frames, turning.steps(), math.radians(case.told_deg))
    numbered, names = dict(enumerate(frames)), [f"frame {number}" for number in range(len(frames))]
    lens = CameraLens.of(frames[0], VIEW_RAD)
    places = {number: Attitude(yaw_rad) for number, yaw_rad in enumerate(true_rad)}
    walls = np.full(KNOTS, USUAL_NEARNESS)
    camera = TurnedCamera(lens, Parallax(case.ahead_m / PLACE_M[2], case.left_m / PLACE_M[2], walls, _depths(lens)))
    placement = replace(place_frames(numbered, true_rad, lens, names), camera=camera, places=places, unplaced={})
    return stitching._render(numbered, placement, {}, len(frames))


def _depths(lens: CameraLens) -> DepthMap:
    """Return the true distances of what stands round the axis."""
    bottom = lens.height / 2 / lens.focal_px
    row = 2 * bottom / _ROWS
    down, yaws_rad = (np.arange(_ROWS) + 0.5) * row - bottom, (np.arange(_COLUMNS) + 0.5) * 2 * math.pi / _COLUMNS
    return DepthMap(turning.true_nearness(yaws_rad, down).astype(np.float32), -bottom, row)


def measure(case: Case, width: int, seed: int, pictures: Path | None) -> tuple[tuple[str, ...], bool]:
    """Return the row of a case, and whether it reaches its goal."""
    true_rad = turning.noisy(turning.steps(), seed)
    panorama = _stitch(case, [case.frame(yaw, width) for yaw in true_rad], true_rad)
    perfect = _truth(case, panorama, true_rad)
    reached_db, alike = psnr_db(panorama.image, perfect), turning.ssim(panorama.image, perfect)
    off_deg = math.degrees(turning.yaw_error_rad(panorama, true_rad))
    if pictures is not None:
        both = np.vstack((panorama.image, perfect))
        cv2.imwrite(str(pictures / f"{case.name.replace(' ', '-')}.png"), both[..., ::-1])
    goal = "" if case.goal_db is None else f"{case.goal_db:g} dB"
    goal_alike = "" if case.goal_db is None else f"{_ALIKE}"
    row = case.name, f"{reached_db:.1f} dB", goal, f"{alike:.3f}", goal_alike, f"{off_deg:.3f}°"
    reaches = case.goal_db is None or (reached_db >= case.goal_db and alike >= _ALIKE)
    return row, reaches and not panorama.unplaced


def main(arguments: list[str]) -> int:
    """Return 1 if a case missed its goal."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.panorama", description=__doc__)
    parser.add_argument("--width", type=int, default=640, help="of the frames, in pixels")
    parser.add_argument("--seed", type=int, default=1, help="of odometry's errors")
    parser.add_argument("--page", type=Path, help="the page to write the table into")
    parser.add_argument("--pictures", type=Path, help="a folder for each panorama above the perfect one")
    options = parser.parse_args(arguments)
    rows, holds = [_HEADINGS, ("---",) * len(_HEADINGS)], True
    for case in CASES:
        row, reached = measure(case, options.width, options.seed, options.pictures)
        sys.stdout.write(" | ".join(row) + "\n")
        sys.stdout.flush()
        rows.append(row)
        holds &= reached
    if options.page is not None:
        table = "\n".join("| " + " | ".join(row) + " |" for row in rows)
        size = f"{options.width} x {options.width * 3 // 4} px"
        write_between(options.page, _MARK, f"{table}\n\nFrames of {size}, seed {options.seed}, on {machine()}.")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
