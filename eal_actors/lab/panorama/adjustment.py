"""Bundle adjustment: the lens and the attitudes of a camera that best explain all matching points.

A field of view from a data sheet is often wrong by some percent, and cheap lenses distort. Both shift the frames
against one another, and the shifts of a whole ring, which must add up to a full turn, determine them. A camera beside
the axis of rotation sees near things shifted more than far ones: its position is estimated with the distances of the
walls.

Levenberg-Marquardt with a Cauchy loss, whose scale shrinks: at first every match counts, in the end those alone that
fit, so that a few things that moved do no harm.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eal_actors.lab.panorama.cylinder import Attitude, CameraLens, Floats, wrapped_rad
from eal_actors.lab.panorama.parallax import KNOTS, USUAL_NEARNESS, Parallax, TurnedCamera, knot_weights
from eal_actors.lab.panorama.ring import Links, Ring

_ODOMETRY_SIGMA_RAD: Final = math.radians(3)
"""Assumed error of odometry for one turn: large enough that pictures always outweigh it."""
_LENS_SIGMAS: Final = np.array([0.05, 0.1])  # of the focal length's logarithm and of k1
_LENS: Final = slice(0, 2)
_PLACE: Final = slice(2, 4)
_NEAR: Final = slice(4, 4 + KNOTS)
_ATTITUDES: Final = slice(4 + KNOTS, None)
_PLACE_SIGMA: Final = 0.3  # camera heights
_NEARNESS_SIGMA: Final = 0.1
_ROUGH_RAD: Final = 0.002  # shift by what stands before the walls, for a camera 8 cm beside the axis
_SLOPE_SIGMA: Final = 0.05  # of the difference of nearness between two knots
_TELLING: Final = 25.0  # decrease of the cost, in squared errors of a point, from which another lens is believed
_BESIDE: Final = 0.9
"""Share of the cost below which a camera beside the axis is believed: 0.27 to 0.84 if it is, 0.96 if not."""
_OPEN: Final = 0.02  # share of these for an open ring, whose overlaps alone hardly determine a lens
_LEVEL_SIGMA_RAD: Final = math.radians(0.2)
_MOST_ZOOM: Final = 0.3  # largest change of the focal length's logarithm
_LOSS_SCALES: Final = (100.0, 25.0, 6.0)  # in standard errors
_MOST_STEPS: Final = 30
_ENOUGH: Final = 1e-5  # relative decrease of the cost below which a scale is done
_STEP: Final = 1e-6
_DAMPING: Final = (1e-9, 1e-3, 1e6)


@dataclass(frozen=True, slots=True, eq=False)
class _Points:
    """All matching points: the numbers of the two frames that show each (n,), its pixels in both (n, 2), its error.

    `knots` are the shares of the knots in the nearness of the wall there, (n, KNOTS).
    """

    first: Floats
    second: Floats
    first_px: Floats
    second_px: Floats
    sigma_rad: Floats
    knots: Floats

    def rough(self) -> _Points:
        """Return them with the error of a model whose walls are smooth."""
        return replace(self, sigma_rad=np.hypot(self.sigma_rad, _ROUGH_RAD))


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    """The points and priors. Parameters: log zoom, k1, camera's place, walls' nearness, yaws, depressions, rolls."""

    given: CameraLens
    camera: TurnedCamera
    points: _Points
    yaws_rad: Floats
    neighbours: Floats
    is_closed: bool

    @property
    def start(self) -> Floats:
        """The parameters of a level camera with the present lens and position and the yaws of odometry."""
        zeros = np.zeros(len(self.yaws_rad))
        (lens, parallax), given_px = self.camera, self.given.focal_px
        first = [math.log(lens.focal_px / given_px), lens.k1, parallax.ahead, parallax.left]
        return np.concatenate((first, parallax.nearness, self.yaws_rad, zeros, zeros))

    def lens_of(self, parameters: Floats) -> CameraLens:
        zoom = math.exp(float(np.clip(parameters[0], -_MOST_ZOOM, _MOST_ZOOM)))
        view_rad = 2 * math.atan(math.tan(self.given.field_of_view_rad / 2) / zoom)
        return replace(self.given, field_of_view_rad=view_rad, k1=float(parameters[1]))

    def attitudes(self, parameters: Floats) -> Floats:
        """Return yaws, depressions and rolls, (3, n)."""
        return parameters[_ATTITUDES].reshape(3, -1)

    def parallax_of(self, parameters: Floats) -> Parallax:
        """Return the camera's place and the walls."""
        ahead, left = parameters[_PLACE].tolist()
        return Parallax(ahead, left, np.maximum(parameters[_NEAR], 0.0))

    def misses(self, parameters: Floats, turned: tuple[int, int] | None = None, nearer: float = 0.0) -> Floats:
        """Return the distance of each point's two rays, to the side and in height, in standard errors, (2, n).

        `turned` is the end (0 or 1) and the axis (0 to 2) of the attitudes to change by a small step; `nearer` is a
        change of the nearness of all walls.
        """
        lens, points, attitudes = self.lens_of(parameters), self.points, self.attitudes(parameters)
        first, second = attitudes[:, points.first], attitudes[:, points.second]
        if turned is not None:
            (first, second)[turned[0]][turned[1]] += _STEP
        parallax = self.parallax_of(parameters)
        nearness = points.knots @ parallax.nearness + nearer
        right_rad, down = parallax.seen_from_axis(*lens.rays(points.first_px, first[1], first[2]), nearness)
        other_rad, other_down = parallax.seen_from_axis(*lens.rays(points.second_px, second[1], second[2]), nearness)
        aside_rad = wrapped_rad(first[0] - right_rad - second[0] + other_rad)
        return np.stack((aside_rad, down - other_down)) / points.sigma_rad

    def priors(self, parameters: Floats) -> Floats:
        """Return how far the parameters are from what is likely, in standard deviations, (m,)."""
        yaws_rad, downs_rad, rolls_rad = self.attitudes(parameters)
        corrections_rad = yaws_rad - self.yaws_rad
        before, after = self.neighbours
        sigmas = _LENS_SIGMAS if self.is_closed else _LENS_SIGMAS * _OPEN
        return np.concatenate(
            (
                (parameters[_LENS] - (0.0, self.given.k1)) / sigmas,
                parameters[_PLACE] / _PLACE_SIGMA,
                (parameters[_NEAR] - USUAL_NEARNESS) / _NEARNESS_SIGMA,
                (parameters[_NEAR] - np.roll(parameters[_NEAR], 1)) / _SLOPE_SIGMA,
                (corrections_rad[after] - corrections_rad[before]) / _ODOMETRY_SIGMA_RAD,
                [corrections_rad.sum()],  # odometry fixes the absolute yaw
                downs_rad / _LEVEL_SIGMA_RAD,
                rolls_rad / _LEVEL_SIGMA_RAD,
            )
        )

    def cost(self, parameters: Floats, scale: float) -> float:
        squares = (self.misses(parameters) ** 2).sum(axis=0)
        return float((scale**2 * np.log1p(squares / scale**2)).sum() + (self.priors(parameters) ** 2).sum())

    def equations(self, parameters: Floats, scale: float, free: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return the normal equations of the next step of the free parameters, (f, f) and (f,)."""
        misses, priors = self.misses(parameters), self.priors(parameters)
        weights = np.sqrt(1 / (1 + (misses**2).sum(axis=0) / scale**2))
        slopes = np.zeros((len(parameters), *misses.shape))
        prior_slopes = np.empty((len(parameters), len(priors)))
        for number in free.tolist():  # the others would cost half of the time
            beside = parameters.copy()
            beside[number] += _STEP
            prior_slopes[number] = (self.priors(beside) - priors) / _STEP
            if number < _PLACE.stop:
                slopes[number] = (self.misses(beside) - misses) / _STEP
        change = (self.misses(parameters, nearer=_STEP) - misses) / _STEP
        slopes[_NEAR] = self.points.knots.T[:, np.newaxis] * change
        for axis in range(3):  # an attitude moves the points of its own frame only: one step for all frames
            for end, frames in enumerate((self.points.first, self.points.second)):
                change = (self.misses(parameters, turned=(end, axis)) - misses) / _STEP
                rows = _ATTITUDES.start + axis * len(self.yaws_rad) + frames
                slopes[rows, :, np.arange(len(frames))] += change.T
        of_points = (slopes[free] * weights).reshape(len(free), -1)
        all_slopes = np.concatenate((of_points, prior_slopes[free]), axis=1)
        return all_slopes @ all_slopes.T, all_slopes @ np.concatenate(((misses * weights).ravel(), priors))


def adjust_bundle(
    given: CameraLens,
    camera: TurnedCamera,
    yaws_rad: Mapping[int, float],
    projected_rad: Mapping[int, float],
    ring: Ring,
    links: Links,
    *,
    may_be_beside: bool = True,
) -> tuple[TurnedCamera, dict[int, Attitude]]:
    """Return the camera, and its attitude at each frame.

    `given` is the lens as far as it is known; `camera` projected the frames for comparison, at the yaws
    `projected_rad`; `yaws_rad` are those by odometry. A camera beside the axis is looked for if it `may_be_beside`.

    Thread: any; it may take a second.
    """
    order = {number: index for index, number in enumerate(ring.order)}
    pairs = np.array([(order[first], order[second]) for first, second, _ in ring.neighbours() if first != second], int)
    problem = _Problem(
        given,
        camera,
        _points_of(links, camera, order, projected_rad),
        np.array([yaws_rad[number] for number in order]),
        pairs.reshape(-1, 2).T,
        ring.is_closed,
    )
    parameters = _best_parameters(problem, may_be_beside=may_be_beside and ring.is_closed)
    found = problem.attitudes(parameters)
    attitudes = {number: Attitude(*found[:, index].tolist()) for number, index in order.items()}
    return TurnedCamera(problem.lens_of(parameters), problem.parallax_of(parameters)), attitudes


def _best_parameters(problem: _Problem, *, may_be_beside: bool) -> Floats:
    """Return the best parameters.

    The given lens and a camera on the axis are kept unless other ones explain the points clearly better. A position
    beside the axis comes first: another lens explains a part of what it does.
    """
    rough = replace(problem, points=problem.points.rough())
    beside_axis = (_PLACE, _NEAR, _ATTITUDES)
    if problem.camera.parallax.is_some:
        best = _minimise(rough, problem.start, beside_axis)
        return _better(rough, best, _minimise(rough, best, (_LENS, *beside_axis)))
    same_lens = _minimise(problem, problem.start, (_ATTITUDES,))
    best = _better(problem, same_lens, _minimise(problem, same_lens, (_LENS, _ATTITUDES)))
    if not may_be_beside:
        return best
    beside = _minimise(rough, problem.start, beside_axis)
    costs = [rough.cost(parameters, _LOSS_SCALES[-1]) for parameters in (beside, same_lens, best)]
    if costs[0] < min(_BESIDE * costs[1], costs[2]):
        return beside
    if best is same_lens:
        return best
    beside = _minimise(rough, problem.start, (_LENS, *beside_axis))
    return beside if rough.cost(beside, _LOSS_SCALES[-1]) < _BESIDE * costs[2] else best


def _better(problem: _Problem, best: Floats, other: Floats) -> Floats:
    """Return the other parameters if they explain the points clearly better, else the best ones so far."""
    least, most = (problem.cost(parameters, _LOSS_SCALES[-1]) for parameters in (other, best))
    return other if most - least > _TELLING * least / max(len(problem.points.first), 1) else best


def _points_of(links: Links, camera: TurnedCamera, order: Mapping[int, int], yaws_rad: Mapping[int, float]) -> _Points:
    """Return the points of all links, brought back from the patches to the pixels of the frames."""
    counts, focal_px = [len(shift.first_px) for shift in links.values()], camera.lens.focal_px
    centre = np.array([camera.lens.width - 1, camera.lens.height - 1]) / 2

    def pixels(numbers: list[int], points_px: list[Floats]) -> tuple[Floats, Floats]:
        right_rad, down = (np.concatenate([*points_px, np.empty((0, 2))]) / focal_px).T
        directions_rad = np.repeat([yaws_rad[number] for number in numbers], counts) - right_rad
        x, y, _ = camera.lens.pixels(*camera.parallax.seen_from_camera(right_rad, down, directions_rad))
        return np.column_stack((x, y)) - centre, directions_rad

    firsts, seconds = [first for first, _ in links], [second for _, second in links]
    first_px, directions_rad = pixels(firsts, [shift.first_px for shift in links.values()])
    second_px, _ = pixels(seconds, [shift.second_px for shift in links.values()])
    return _Points(
        np.repeat([order[number] for number in firsts], counts).astype(int),
        np.repeat([order[number] for number in seconds], counts).astype(int),
        first_px,
        second_px,
        np.repeat([shift.sigma_px for shift in links.values()], counts) / focal_px,
        knot_weights(directions_rad),
    )


def _minimise(problem: _Problem, parameters: Floats, parts: Sequence[slice]) -> Floats:
    """Return the parameters of the least cost; those outside of the given parts keep their values."""
    free = np.concatenate([np.arange(len(parameters))[part] for part in parts])
    least_damping, damping, most_damping = _DAMPING
    for scale in _LOSS_SCALES:
        cost = problem.cost(parameters, scale)
        for _ in range(_MOST_STEPS):
            curvature, slope = problem.equations(parameters, scale, free)
            tried = parameters.copy()
            tried[free] -= np.linalg.solve(curvature + damping * np.diag(np.diag(curvature)), slope)
            reached = problem.cost(tried, scale)
            if reached >= cost:
                damping *= 10
                if damping > most_damping:
                    damping = _DAMPING[1]
                    break
                continue
            gain, cost = cost - reached, reached
            parameters, damping = tried, max(damping / 5, least_damping)
            if gain < _ENOUGH * cost:
                break
    return parameters
