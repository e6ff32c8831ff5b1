"""Direct alignment: the attitudes and the position of a camera beside the axis, by the brightness of all pixels.

As long as the distances of other things are not known, only the floor is compared: its distance follows from the
depression. Features of walls determine neither the turns nor the position well, because a turn and a wrong distance
shift them alike: they leave up to 0.4 degrees and 25 % of the position, where the floor leaves 0.03 degrees and 1 %.

Gauss-Newton with a Cauchy loss, from coarse to fine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

import cv2
import numpy as np

from eal_actors.lab.panorama.cylinder import Attitude, Floats, Image, Mask, wrapped_rad
from eal_actors.lab.panorama.parallax import KNOTS, Parallax, TurnedCamera, knot_weights
from eal_actors.lab.panorama.ring import Ring

_SCALES: Final = ((0.011, 24.0), (0.0055, 12.0), (0.0035, 6.0))
"""Blurs in radians: 6, 3 and 2 px of a frame of 640 px and 60 degrees. And the differences in grey levels, from which a
point counts less because it is no floor: at first they must exceed those by wrong attitudes."""
_STEP_RAD: Final = 0.0045  # between compared points; more if they were too many, with a wide lens
_MOST_POINTS: Final = 20_000  # of a pair of frames
_STEEPEST: Final = 1.0  # tangent of the depression of compared points
_CLEAR_OF_WALLS: Final = 1.3  # nearness of compared floor, in those of the wall behind it, which is known roughly
_REACH_RAD: Final = 0.04  # beyond the overlap, in which the camera's position may move things
_SHARE: Final = 0.1  # of the points count as independent: neighbours are alike
_LOWEST: Final = 0.7  # of the depression of the lower edge: from there on all is taken for floor
_FEWEST: Final = 200  # points of a link
_TURN_SIGMA_RAD: Final = math.radians(3)
_LEVEL_SIGMA_RAD: Final = math.radians(0.05)
_PLACE_SIGMA: Final = 0.3  # camera heights
_MOST_STEPS: Final = 40  # features may leave 4 degrees, which take many steps
_MUCH_WORSE: Final = 1.25  # loss in that of the start: obstacles that are taken for floor make it vary
_ENOUGH: Final = 0.025  # of the blur, for the last step
_MEAN_SIGMA_RAD: Final = 3e-5
_CHANGE: Final = 1e-4


class _View(NamedTuple):
    """A view of some directions: brightness (m, n), its slopes by the parameters (5, m, n), and where the frame is."""

    levels: Floats
    slopes: Floats
    reaches: Mask


def align_pixels(
    frames: Mapping[int, Image], camera: TurnedCamera, places: Mapping[int, Attitude], ring: Ring
) -> tuple[TurnedCamera, dict[int, Attitude]]:
    """Return the camera with its position, and its attitudes, that make frames alike where they overlap.

    The frames, by number, are of equal brightness, and their ring is closed. If the camera has no distances of what
    stands round it, only the floor is compared.

    Thread: any; it may take a second.
    """
    order = list(ring.order)
    start = np.concatenate([*(places[number] for number in order), [camera.parallax.ahead, camera.parallax.left]])
    found = start
    for blur_rad, levels in _SCALES if camera.parallax.depths is None else _SCALES[1:]:
        blurred = [_with_gradients(frames[number], blur_rad * camera.lens.focal_px) for number in order]
        for _ in range(_MOST_STEPS):
            step, _ = _step(blurred, camera, found, start, levels)
            found = found - step
            if np.abs(step).max() < _ENOUGH * blur_rad:
                break
    reached, before = (_step(blurred, camera, each, start, levels)[1] for each in (found, start))
    if reached > _MUCH_WORSE * before:
        return camera, dict(places)  # a floor without texture leads nowhere
    attitudes = {number: Attitude(*found[3 * at : 3 * at + 3].tolist()) for at, number in enumerate(order)}
    return _at(camera, found, camera.parallax), attitudes


def _at(camera: TurnedCamera, parameters: Floats, surroundings: Parallax) -> TurnedCamera:
    """Return the camera at the position of some parameters, in surroundings."""
    ahead, left = parameters[-2:].tolist()
    return camera._replace(parallax=replace(surroundings, ahead=ahead, left=left))


def _with_gradients(frame: Image, blur_px: float) -> Floats:
    """Return a frame's brightness and its slopes to the right and down, (h, w, 3)."""
    sharp = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY).astype(np.float32)
    grey = cv2.GaussianBlur(sharp, (0, 0), max(blur_px, 0.5))
    slopes = (cv2.Sobel(grey, cv2.CV_32F, *axes, scale=1 / 8) for axes in ((1, 0), (0, 1)))
    return np.dstack((grey, *slopes))


def _step(
    blurred: list[Floats], camera: TurnedCamera, found: Floats, start: Floats, levels: float
) -> tuple[Floats, float]:
    """Return how far the parameters are from the best ones of the linear problem, and the mean loss of a point."""
    count = len(blurred)
    curvature, slope = _priors(found, start)
    losses = [0.0]
    for one in range(count):
        other = (one + 1) % count
        turn_rad = wrapped_rad(found[3 * one] - found[3 * other])
        half_rad = min(camera.lens.half_view_rad - turn_rad / 2, turn_rad / 2) + _REACH_RAD
        bottom = min(camera.lens.height / 2 / camera.lens.focal_px, _STEEPEST)
        step_rad = max(_STEP_RAD, math.sqrt(4 * half_rad * bottom / _MOST_POINTS))
        yaws_rad = found[3 * one] - turn_rad / 2 - np.arange(-half_rad, half_rad, step_rad)
        down, is_known = _known_rows(camera, yaws_rad, np.arange(-bottom, bottom, step_rad)[:, np.newaxis])
        first, second = (_look(blurred[at], camera, found, at, yaws_rad, down) for at in (one, other))
        common = first.reaches & second.reaches & is_known
        if int(common.sum()) < _FEWEST:
            continue
        misses = (first.levels - second.levels)[common]
        misses = misses - np.median(misses)
        losses.append(float(np.log1p((misses / levels) ** 2).mean()))
        weights = _SHARE / (levels**2 + misses**2)
        of_first, of_second = first.slopes[:, common], second.slopes[:, common]
        slopes = np.concatenate((of_first[:3], -of_second[:3], of_first[3:] - of_second[3:]))
        slopes -= np.average(slopes, axis=1, weights=weights)[:, np.newaxis]
        rows = np.array([*range(3 * one, 3 * one + 3), *range(3 * other, 3 * other + 3), -2, -1])
        weighed = slopes * weights
        curvature[np.ix_(rows, rows)] += weighed @ slopes.T
        slope[rows] += weighed @ misses
    return np.linalg.solve(curvature, slope), math.fsum(losses)


def _known_rows(camera: TurnedCamera, yaws_rad: Floats, down: Floats) -> tuple[Floats, Mask]:
    """Return those of some depressions (h, 1) that can be compared, (m, 1), and where the distance is known, (m, n)."""
    if camera.parallax.depths is not None:
        return down, np.ones((len(down), len(yaws_rad)), bool)
    walls = _CLEAR_OF_WALLS * (knot_weights(yaws_rad) @ camera.parallax.nearness)
    walls = np.minimum(walls, _LOWEST * down[-1])  # a link that nothing determines would spoil the ring
    down = down[down[:, 0] > walls.min()]
    return down, down > walls


def _priors(found: Floats, start: Floats) -> tuple[Floats, Floats]:
    """Return the normal equations of what is likely: a level camera, and turns and a position as before."""
    count = (len(found) - 2) // 3
    sigmas = np.array([_TURN_SIGMA_RAD, _LEVEL_SIGMA_RAD, _LEVEL_SIGMA_RAD] * count + [_PLACE_SIGMA] * 2)
    likely = start.copy()
    likely[1:-2:3] = likely[2:-2:3] = 0.0
    curvature, off = np.diag(sigmas**-2), (found - likely) * sigmas**-2
    yaws = np.arange(0, 3 * count, 3)
    curvature[np.ix_(yaws, yaws)] += _MEAN_SIGMA_RAD**-2  # their mean stays: nothing tells it
    off[yaws] += (found - start)[yaws].sum() * _MEAN_SIGMA_RAD**-2
    return curvature, off


def _look(blurred: Floats, camera: TurnedCamera, found: Floats, at: int, yaws_rad: Floats, down: Floats) -> _View:
    """Return what a frame shows if its parameters, and the distances, are right; without distances, all is floor."""
    floor = replace(camera.parallax, nearness=np.zeros(KNOTS))

    def pixels(parameters: Floats) -> tuple[Floats, Floats, Mask]:
        attitude = Attitude(*parameters[:3].tolist())
        return _at(camera, parameters, floor).pixels(wrapped_rad(attitude.yaw_rad - yaws_rad), down, attitude)

    own = np.append(found[3 * at : 3 * at + 3], found[-2:])
    x, y, reaches = pixels(own)
    seen: Floats = np.asarray(
        cv2.remap(blurred, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR), np.float32
    )
    slopes = []
    for number in range(5):
        beside = own.copy()
        beside[number] += _CHANGE
        right, below, _ = pixels(beside)
        slopes.append((seen[..., 1] * (right - x) + seen[..., 2] * (below - y)) / _CHANGE)
    return _View(seen[..., 0], np.array(slopes), reaches)
