"""The look-ahead of a run: reads poses once a second, follows the steps, and reports what it foresees."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, Self

import numpy as np

from eal_actors.actors.future import Future
from eal_actors.actors.many import read_many
from eal_actors.device.info import ResourceType
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.clock import new_waiter
from eal_actors.kernel.errors import EALError, UnavailableError
from eal_actors.kernel.log import get_logger
from eal_actors.lab.lookahead.forecast import ForeseenEvent, PresentState, forecast
from eal_actors.lab.lookahead.script import Script
from eal_actors.recording.value_messages import hull_radii_m, resource_infos
from eal_actors.scenario import Run, RunEvent, StepEnded, StepStarted

_POSE: Final = "Pose"
_ESTIMATE: Final = "estimate"
_BATTERY: Final = "Battery"
_POSE_NUMBERS: Final = (3, 12)
"""Numbers of a pose, and of one with its covariance."""
_PERIOD_S: Final = 1.0
_HELD_PERIOD_S: Final = 0.25
_HELD_S: Final = 3.0
"""After a hold looks come sooner for a while: a robot whose step failed may begin the next one at once, and near to
the other one."""
_ANSWER_S: Final = 0.5
_HALT_S: Final = 2.0
_DEFAULT_RADIUS_M: Final = 0.2
_LOW_CHARGE: Final = 0.1
_SLOPE_S: Final = 10.0
"""Shortest time over which the consumption of a battery is measured."""


@dataclass(frozen=True, slots=True)
class LookaheadOptions:
    """The extent of the look-ahead.

    Attributes:
        horizon_s: how far to look, in seconds of the fleet's clock.
        margin_m: outlines that come nearer than this are taken to touch.
        holds: halt the robots concerned before a contact, and before they leave the area.
        hold_s: a robot is halted if it would touch something within this time.
        hold_likelihood: and if the probability of that is at least this.
    """

    horizon_s: float = 10.0
    margin_m: float = 0.02
    holds: bool = False
    hold_s: float = 3.0
    hold_likelihood: float = 0.95


@dataclass
class _Tracked:
    """A robot of the run: how far it is in its script, and its battery at first."""

    script: Script | None
    index: int = -1
    since_s: float = 0.0
    is_running: bool = False
    began_at: Future[Any] | None = None
    charges: list[tuple[float, float]] = field(default_factory=list)


class Lookahead:
    """Looks ahead inside its `with` block, once a second of the fleet's clock.

    `on_look` is called with the time of each look, by the fleet's clock, and all its findings; `may_hold` is asked with
    the time and the finding before robots are halted, and false lets them go on. Thread of both: the look-ahead's own.
    `hear` is a listener of the run. `attach` names the run whose record gets the findings.
    """

    def __init__(
        self,
        fleet: Fleet,
        robots: tuple[str, ...],
        scripts: Mapping[str, Script],
        options: LookaheadOptions | None = None,
        on_look: Callable[[float, Sequence[ForeseenEvent]], None] | None = None,
        may_hold: Callable[[float, ForeseenEvent], bool] = lambda _time_s, _finding: True,
    ) -> None:
        self._fleet = fleet
        self._options = options or LookaheadOptions()
        self._on_look = on_look
        self._may_hold = may_hold
        infos = resource_infos(fleet, robots)
        self._names = [name for name in infos if _POSE in infos[name]]
        self._estimating = [
            name for name in self._names if any(one.name == _ESTIMATE for one in infos[name][_POSE].requests)
        ]
        self._powered = [name for name in self._names if _BATTERY in infos[name]]
        self._radii_m = hull_radii_m(fleet, infos)
        self._tracked = {name: _Tracked(scripts.get(name), since_s=fleet.clock.now()) for name in self._names}
        self._strange: set[str] = set()
        self._known: set[tuple[str, str, str | None]] = set()
        self._run: Run | None = None
        self._lock = threading.Lock()
        self._stop = new_waiter()
        self._thread = threading.Thread(target=self._watch, name="look-ahead", daemon=True)

    def attach(self, run: Run) -> None:
        """Send the findings to the record of a run."""
        self._run = run

    def __enter__(self) -> Self:
        self._fleet.clock.start(self._thread)
        return self

    def __exit__(self, *_exc_info: object) -> None:
        self._fleet.clock.wake(self._stop)
        with self._fleet.clock.outside():
            self._thread.join()

    def hear(self, event: RunEvent) -> None:
        """Follow the steps of the robots. Thread: the run's; does not block."""
        if isinstance(event, StepStarted) and event.robot in self._tracked:
            began_at = self._fleet[event.robot][_POSE].get_value(timeout_s=_ANSWER_S)
            with self._lock:
                self._begin(self._tracked[event.robot], event.step, began_at)
        elif isinstance(event, StepEnded) and (robot := event.record.robot) in self._tracked and robot is not None:
            with self._lock:
                tracked = self._tracked[robot]
                tracked.is_running, tracked.since_s = False, self._fleet.clock.now()

    def _begin(self, tracked: _Tracked, path: str, began_at: Future[Any]) -> None:
        steps = tracked.script.steps if tracked.script is not None else ()
        following = range(max(0, tracked.index + (not tracked.is_running)), len(steps))
        index = next((number for number in following if steps[number].path == path), None)
        if index is None:  # it does something that it did not do in the rehearsal
            tracked.script = None
            return
        tracked.index, tracked.is_running, tracked.began_at = index, True, began_at
        tracked.since_s = self._fleet.clock.now()

    # The look-ahead's own thread.

    def _watch(self) -> None:
        clock, soon_until_s = self._fleet.clock, -math.inf
        while not clock.wait(self._stop, _HELD_PERIOD_S if clock.now() < soon_until_s else _PERIOD_S):
            try:
                if self._look():
                    soon_until_s = clock.now() + _HELD_S
            except EALError as error:
                get_logger().warning("no look ahead", reason=str(error))

    def _look(self) -> bool:
        """Look ahead once; return whether robots were held."""
        poses = self._read_poses()
        now_s = self._fleet.clock.now()
        with self._lock:
            states = {name: self._state(name, numbers, now_s) for name, numbers in poses.items()}
        options = self._options
        found = forecast(states, options.horizon_s, options.margin_m, self._fleet.config.world).findings
        findings = [*found, *self._empty_batteries(now_s)]
        if self._on_look is not None:
            self._on_look(now_s, findings)
        self._known &= {(finding.kind, finding.robot, finding.other) for finding in findings}
        held = [self._report(now_s, finding) for finding in findings]
        return any(held)

    def _read_poses(self) -> dict[str, list[float]]:
        """Return x, y and yaw of each robot that answers in time, and the covariance by rows if it is estimated."""
        handles = {name: self._fleet[name][_POSE] for name in self._names}
        estimating = {name: handles[name].send_req(_ESTIMATE, timeout_s=_ANSWER_S) for name in self._estimating}
        others = [name for name in self._names if name not in estimating]
        read = read_many([handles[name] for name in others], _ANSWER_S)
        return self._answered({**estimating, **dict(zip(others, read, strict=True))}, _POSE_NUMBERS)

    def _state(self, name: str, numbers: Sequence[float], now_s: float) -> PresentState:
        tracked = self._tracked[name]
        began = tracked.began_at
        x_m, y_m, yaw_rad, *rows = numbers
        state = PresentState(
            (x_m, y_m, yaw_rad),
            self._radii_m.get(name, _DEFAULT_RADIUS_M),
            tracked.script,
            tracked.index,
            now_s - tracked.since_s,
            tracked.is_running,
            covariance=np.array(rows).reshape(3, 3) if rows else None,
        )
        if began is None or not began.done() or began.exception() is not None:
            return state
        first_x_m, first_y_m, first_yaw_rad = map(float, began.get().value)
        return replace(state, began_at=(first_x_m, first_y_m, first_yaw_rad))

    def _empty_batteries(self, now_s: float) -> list[ForeseenEvent]:
        found = []
        read = read_many([self._fleet[name][_BATTERY] for name in self._powered], _ANSWER_S)
        for name, (charge,) in self._answered(dict(zip(self._powered, read, strict=True)), (1,)).items():
            charges = self._tracked[name].charges
            charges.append((now_s, charge))
            while len(charges) > 2 and now_s - charges[1][0] >= _SLOPE_S:
                charges.pop(0)
            first_s, first = charges[0]
            spent = (first - charge) / (now_s - first_s) if now_s - first_s >= _SLOPE_S else 0.0
            if charge - spent * self._options.horizon_s < _LOW_CHARGE:
                in_s = max(0.0, (charge - _LOW_CHARGE) / spent) if spent > 0 else 0.0
                found.append(ForeseenEvent("battery", name, None, in_s, ()))
        return found

    def _answered(self, asked: Mapping[str, Future[Any]], counts: Container[int]) -> dict[str, list[float]]:
        """Return the answers by robot, without those that failed, are late, or have another count of finite numbers."""
        found = {}
        for name, answer in asked.items():
            try:
                value = answer.get().value
            except EALError:
                continue
            if (numbers := _finite(value)) is not None and len(numbers) in counts:
                found[name] = numbers
            elif name not in self._strange:
                self._strange.add(name)
                get_logger(robot=name).warning(
                    "no look ahead for it", reason=f"its answer is no pose or charge: {value!r}"
                )
        return found

    def _report(self, now_s: float, finding: ForeseenEvent) -> bool:
        key = (finding.kind, finding.robot, finding.other)
        holds = self._holds(finding) and self._may_hold(now_s, finding)
        if key in self._known and not holds:
            return False
        self._known.add(key)
        if holds:
            for name in finding.movers:
                self._halt(name)
        if self._run is not None:
            self._run.log(finding.robot, describe(finding, is_held=holds))
        return holds

    def _holds(self, finding: ForeseenEvent) -> bool:
        options = self._options
        is_near = bool(finding.movers) and finding.in_s <= options.hold_s
        return options.holds and is_near and finding.likelihood >= options.hold_likelihood

    def _halt(self, name: str) -> None:
        for resource in self._fleet[name].values():
            try:
                if ResourceType.ACTUATOR in resource.info.types:
                    resource.halt(timeout_s=_HALT_S)
            except UnavailableError:  # it was never up, so it does not move
                continue


def _finite(value: Any) -> list[float] | None:
    """Return a number or an array as numbers; None if one is not finite, or none."""
    try:
        numbers = [float(number) for number in np.ravel(value)]
    except (TypeError, ValueError):
        return None
    return numbers if all(map(math.isfinite, numbers)) else None


def describe(finding: ForeseenEvent, *, is_held: bool) -> str:
    """Return a finding for people."""
    what = {
        "contact": f"will touch {finding.other}",
        "area": f"will leave the area at {finding.other}",
        "battery": f"will have less than {_LOW_CHARGE:.0%} of its charge",
    }[finding.kind]
    held = f"; halted: {', '.join(finding.movers)}" if is_held else ""
    return f"look-ahead: {what} in {finding.in_s:.1f} s{held}"
