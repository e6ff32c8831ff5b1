"""The forecast: robots continue their scripts from their present poses; the gaps between their outlines follow.

Pure functions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from eal_actors.device.localization.pose_estimate import Pose
from eal_actors.device.world.model import BoxObstacle, CircleObstacle, Drop, WorldModel
from eal_actors.lab.lookahead.script import Floats, Script, ScriptStep

TICK_S: Final = 0.1
_APPROACH_M: Final = 0.01
"""Robots that stand side by side do not approach; a gap that shrinks by less is none of the plan's."""
_YAW_M: Final = 0.3
"""A radian of turn counts as much as this distance when a motion's progress is sought."""
_WHEEL_SHARE: Final = 0.03
"""Errors of wheels and floor, as a share of the way ahead."""
_LEAST_M: Final = 0.005
"""The least standard deviation of a gap: outlines and clocks are not exact."""
_BEYOND_S: Final = 1.0
"""A path that a wall or an obstacle stopped is continued into it for at most this time."""


@dataclass(frozen=True, slots=True)
class PresentState:
    """The present state of a robot.

    Attributes:
        pose: estimated x in m, y in m and yaw in rad in the map frame.
        radius_m: of the disc about its centre.
        script: its script; without one it is taken to stand.
        index: the number of its last step that has started, below 0 before the first.
        elapsed_s: seconds since that step started, or since it ended.
        is_running: that step has not ended.
        began_at: its pose when that step started, if it is known.
        covariance: of the pose, (3, 3); None if it is not known.
    """

    pose: Pose
    radius_m: float
    script: Script | None = None
    index: int = -1
    elapsed_s: float = 0.0
    is_running: bool = False
    began_at: Pose | None = None
    covariance: Floats | None = None


@dataclass(frozen=True, slots=True)
class ForeseenEvent:
    """A foreseen event.

    Attributes:
        kind: `contact`, `area` (the robot leaves the floor) or `battery`.
        other: the other robot or thing; None for a battery.
        in_s: seconds from now.
        movers: the robots of the two that move until then.
        likelihood: the probability of a touch, by the uncertainty of the poses, from 0 to 1.
    """

    kind: str
    robot: str
    other: str | None
    in_s: float
    movers: tuple[str, ...]
    likelihood: float = 1.0


@dataclass(frozen=True, slots=True)
class Forecast:
    """Future poses by robot, one each `TICK_S` from now on, shape (n, 3), and what follows from them, soonest first."""

    poses: Mapping[str, Floats]
    findings: tuple[ForeseenEvent, ...]


def forecast(
    robots: Mapping[str, PresentState], horizon_s: float, margin_m: float, world: WorldModel | None = None
) -> Forecast:
    """Continue the scripts of all robots, and find what comes nearer to them than the margin within the horizon."""
    clocks = _clocks(robots, max(1, round(horizon_s / TICK_S)))
    poses = {
        name: _continued(state.script, clocks[name], state.pose)
        if state.script is not None
        else np.tile(np.array(state.pose), (len(clocks[name]), 1))
        for name, state in robots.items()
    }
    findings = [*_meetings(robots, poses, margin_m)]
    if world is not None:
        unstopped = {
            name: poses[name] if state.script is None else _unstopped(state.script, clocks[name], poses[name])
            for name, state in robots.items()
        }
        findings += _hits(robots, unstopped, margin_m, world)
    return Forecast(poses, tuple(sorted(findings, key=lambda finding: finding.in_s)))


# Time: how far each robot is in its script, and when waits for others end.


def _clocks(robots: Mapping[str, PresentState], ticks: int) -> dict[str, Floats]:
    """Return the time in its script of each robot at each tick; 0 without a script."""
    scripts = {name: state.script for name, state in robots.items() if state.script is not None}
    now = {name: script_time(robots[name], script) for name, script in scripts.items()}
    clocks = {name: [time_s] for name, time_s in now.items()}
    ends = {name: max((step.end_s for step in script.steps), default=0.0) for name, script in scripts.items()}
    for _ in range(ticks):
        latest = {name: times[-1] for name, times in clocks.items()}
        under_way = [time_s for name, time_s in latest.items() if time_s < ends[name]]
        slowest_s = min(under_way, default=math.inf)
        for name, time_s in latest.items():
            later_s = time_s + TICK_S
            if (gate_s := _gate(scripts[name], time_s)) is not None:
                later_s = max(time_s, min(later_s, max(slowest_s + TICK_S, now[name]), gate_s + TICK_S))
            clocks[name].append(later_s)
    return {name: np.array(clocks[name]) if name in clocks else np.zeros(ticks + 1) for name in robots}


def script_time(state: PresentState, script: Script) -> float:
    """Return the time in the script at which a robot is, by its progress in the step under way."""
    if not script.steps:
        return 0.0
    if state.index < 0:
        return min(state.elapsed_s, script.steps[0].start_s)
    step = script.steps[state.index]
    if not state.is_running:
        following = script.steps[state.index + 1 : state.index + 2]
        latest_s = following[0].start_s if following else math.inf
        return min(step.end_s + state.elapsed_s, max(step.end_s, latest_s))
    expected_s = min(step.start_s + state.elapsed_s, step.end_s)
    return expected_s if state.began_at is None else _progress(script, step, state.began_at, state.pose, expected_s)


def _progress(
    script: Script,
    step: ScriptStep,
    began_at: Pose,
    pose: Pose,
    expected_s: float,
) -> float:
    """Return the time of the step at which the twin had come as far as the robot; of several, the expected one."""
    times_s = np.append(np.arange(step.start_s, step.end_s, TICK_S), step.end_s)
    path = script.poses_at(times_s)
    if np.ptp(path[:, 0]) + np.ptp(path[:, 1]) + _YAW_M * np.ptp(path[:, 2]) < _APPROACH_M:
        return expected_s
    far_m = np.hypot(*(path[:, :2] - path[0, :2]).T)
    turned = path[:, 2] - path[0, 2]
    own_m = math.dist(pose[:2], began_at[:2])
    apart = np.abs(np.remainder(turned - (pose[2] - began_at[2]) + math.pi, math.tau) - math.pi)
    cost = np.abs(far_m - own_m) + _YAW_M * apart + 0.01 * np.abs(times_s - expected_s)
    return float(times_s[int(np.argmin(cost))])


def _gate(script: Script, time_s: float) -> float | None:
    """Return the end of the wait for other robots that a time of the script is in, or None."""
    waits = (step.begin_s for step in script.steps if step.start_s <= time_s < step.begin_s - TICK_S / 2)
    return next(waits, None)


# Space: the rest of a script's path from a robot's own pose.


def _continued(script: Script, times_s: Floats, pose: Pose) -> Floats:
    path = script.poses_at(times_s)
    found = np.empty_like(path)
    found[0] = pose
    for tick in range(1, len(path)):
        goal_s = next((s.end_s for s in script.steps if s.has_goal and s.start_s <= times_s[tick - 1] < s.end_s), None)
        if goal_s is None:
            angle = found[tick - 1, 2] - path[tick - 1, 2]
            cos, sin = math.cos(angle), math.sin(angle)
            step_x, step_y, step_yaw = path[tick] - path[tick - 1]
            found[tick] = found[tick - 1] + (cos * step_x - sin * step_y, sin * step_x + cos * step_y, step_yaw)
        else:
            error = found[tick - 1] - path[tick - 1]
            error[2] = math.remainder(error[2], math.tau)
            left = max(0.0, (goal_s - times_s[tick]) / (goal_s - times_s[tick - 1]))
            found[tick] = path[tick] + left * error
    return found


def _unstopped(script: Script, times_s: Floats, path: Floats) -> Floats:
    """Return a path that goes on through what stopped the robot in the rehearsal, until the step ends.

    A robot that is stopped stays where the gap is 0, and there a touch is as likely as none.
    """
    found = path.copy()
    for touch_s in script.touches_s:
        before = int(np.searchsorted(times_s, touch_s)) - 1  # the last tick before the touch
        if before < 1 or times_s[before] <= times_s[before - 1]:
            continue
        velocity = (path[before, :2] - path[before - 1, :2]) / (times_s[before] - times_s[before - 1])
        end_s = next((step.end_s for step in script.steps if step.begin_s <= touch_s <= step.end_s), touch_s)
        beyond = (times_s > touch_s) & (times_s <= min(end_s, touch_s + _BEYOND_S))
        found[beyond, :2] = path[before, :2] + (times_s[beyond] - times_s[before])[:, None] * velocity
    return found


# Gaps.


def _meetings(
    robots: Mapping[str, PresentState], poses: Mapping[str, Floats], margin_m: float
) -> Iterator[ForeseenEvent]:
    for one, other in combinations(robots, 2):
        away_m = poses[one][:, :2] - poses[other][:, :2]
        apart_m = np.hypot(*away_m.T)
        gaps_m = apart_m - robots[one].radius_m - robots[other].radius_m
        tick = _first_touch(gaps_m, margin_m)
        if tick is not None:
            movers = tuple(name for name in (one, other) if _moves(poses[name], tick))
            towards = away_m / np.maximum(apart_m, _APPROACH_M)[:, None]
            variance = _variance(robots[one], poses[one], towards) + _variance(robots[other], poses[other], towards)
            yield ForeseenEvent("contact", one, other, tick * TICK_S, movers, _likelihood(gaps_m, variance, tick))


def _hits(
    robots: Mapping[str, PresentState], poses: Mapping[str, Floats], margin_m: float, world: WorldModel
) -> Iterator[ForeseenEvent]:
    for name, state in robots.items():
        for kind, other, gaps_m in _gaps_m(poses[name], state.radius_m, world):
            if (tick := _first_touch(gaps_m, margin_m)) is not None:
                variance = _variance(state, poses[name], None)
                yield ForeseenEvent(kind, name, other, tick * TICK_S, (name,), _likelihood(gaps_m, variance, tick))


def _gaps_m(path: Floats, radius_m: float, world: WorldModel) -> Iterator[tuple[str, str, Floats]]:
    half = np.array(world.size_m) / 2
    yield "area", "a wall", np.min(half - np.abs(path[:, :2]), axis=1) - radius_m
    for thing in world.solid_obstacles:
        if isinstance(thing, CircleObstacle):
            to_centre_m = np.hypot(path[:, 0] - thing.x_m, path[:, 1] - thing.y_m)
            yield "contact", "an obstacle", to_centre_m - (thing.radius_m + radius_m)
        else:
            yield "contact", "an obstacle", _to_rectangle_m(path, thing) - radius_m
    for drop in world.drops:
        yield "area", "a drop", _to_rectangle_m(path, drop)


def _to_rectangle_m(path: Floats, thing: BoxObstacle | Drop) -> Floats:
    yaw_rad = math.radians(thing.yaw_deg)
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    x, y = path[:, 0] - thing.x_m, path[:, 1] - thing.y_m
    outside = np.stack([np.abs(cos * x + sin * y), np.abs(cos * y - sin * x)]) - np.array(thing.size_m)[:, None] / 2
    distance_m: Floats = np.hypot(*np.maximum(outside, 0.0))
    return distance_m


def _variance(robot: PresentState, path: Floats, towards: Floats | None) -> Floats:
    """Return the variance of a path in m² along some directions, (n, 2), or the mean of all directions.

    An error of the yaw grows to an error of the place with the way ahead, and so do the errors of the wheels.
    """
    if robot.covariance is None:
        return np.zeros(len(path))
    x, y = (path[:, :2] - path[0, :2]).T
    slopes = np.zeros((len(path), 2, 3))
    slopes[:, 0, 0] = slopes[:, 1, 1] = 1.0
    slopes[:, 0, 2], slopes[:, 1, 2] = -y, x
    spread = slopes @ robot.covariance @ slopes.transpose(0, 2, 1)
    wheels = (_WHEEL_SHARE * np.hypot(x, y)) ** 2
    if towards is None:
        mean: Floats = np.trace(spread, axis1=1, axis2=2) / 2 + wheels
        return mean
    along: Floats = np.einsum("ni,nij,nj->n", towards, spread, towards) + wheels
    return along


def _likelihood(gaps_m: Floats, variance: Floats, tick: int) -> float:
    """Return the probability that a gap closes at its narrowest until a second after its first touch."""
    until = tick + round(1.0 / TICK_S)
    deviations = gaps_m[:until] / np.sqrt(variance[:until] + _LEAST_M**2)
    return (1.0 - math.erf(float(deviations.min()) / math.sqrt(2))) / 2


def _first_touch(gaps_m: Floats, margin_m: float) -> int | None:
    """Return the first tick with a gap under the margin that has become smaller, or None."""
    touching = np.flatnonzero((gaps_m < margin_m) & (gaps_m < gaps_m[0] - _APPROACH_M))
    return int(touching[0]) if touching.size else None


def _moves(path: Floats, until: int) -> bool:
    travelled: Sequence[float] = np.ptp(path[: until + 1, :2], axis=0)
    return sum(travelled) > _APPROACH_M
