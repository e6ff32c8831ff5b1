"""Update the robots of a fleet one group after the other, and stop at the first failure.

The robots are the only record: each reports the root hash that it runs and the one in its other slot. So a repeated run
goes on where the last one ended, whatever ended it.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Final, Protocol

from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import EALError
from evbotos.errors import UpdateError

LOOK_S: Final = 1.0
"""Real seconds between two looks at a robot that restarts, or is absent."""


class Outcome(enum.Enum):
    """The result for a robot."""

    UPDATED = "updated"
    ABSENT = "absent"
    IN_USE = "in use"
    UNSUITED = "unsuited"
    FAILED = "failed"
    NOT_BEGUN = "not begun"


class Stage(enum.Enum):
    """How far a robot is."""

    BEHIND = "behind"
    """It runs something else, and its other slot does not hold the update."""
    INSTALLED = "installed"
    """Its next start tries the update."""
    TRYING = "trying"
    """It runs the update, which is not permanent yet."""
    RUNNING = "running"
    """It runs the update."""


@dataclass(frozen=True, slots=True)
class Standing:
    """The state of a robot's slots, as it reports it.

    Attributes:
        start: identifies this start of the machine.
        slot: the running slot.
        good: whether it is permanent.
        due: whether the next start tries the other slot.
        release: the running release.
        verity: identifies the running root.
        other_verity: identifies the root in the other slot; empty if that may not start.
    """

    start: str
    slot: str
    good: bool
    due: bool
    release: str
    platform: str
    verity: str
    other_verity: str


@dataclass(frozen=True, slots=True)
class Update:
    """A signed update.

    Attributes:
        signed: the manifest, to the byte.
        verity: identifies its root.
        parts: the files by part.
    """

    signed: bytes
    signature: bytes
    platform: str
    release: str
    verity: str
    parts: Mapping[str, bytes]


class Robots(Protocol):
    """The robots of a fleet, as an update needs them."""

    def standing(self, robot: str) -> Standing | None:
        """Return what a robot says; None if it does not answer."""

    def unsuited(self, robot: str) -> str | None:
        """Return why a robot that answers takes no updates; None if it does."""

    def used_by(self, robot: str) -> str | None:
        """Return the controller that uses a robot now; None if nobody does."""

    def push(self, robot: str, update: Update) -> None:
        """Write an update into a robot's other slot.

        Raises:
            EALError: the robot refuses it, or went away.
        """

    def restart(self, robot: str) -> None:
        """Restart a robot that has a system to try."""

    def fall_back(self, robot: str) -> None:
        """Let the next start of a robot try its former system."""

    def problem_of(self, robot: str) -> str | None:
        """Return why an updated robot is not healthy; None if it is."""

    def tell(self, robot: str, words: str) -> None:
        """Report a step, to the user and on the robot itself."""


def stage_of(standing: Standing, update: Update) -> Stage:
    """Return how far a robot is."""
    if standing.verity == update.verity:
        return Stage.RUNNING if standing.good else Stage.TRYING
    if standing.due and standing.other_verity == update.verity:
        return Stage.INSTALLED
    return Stage.BEHIND


def groups_of(robots: Sequence[str], size: int) -> Iterator[Sequence[str]]:
    """Yield the robots in groups."""
    for start in range(0, len(robots), size):
        yield robots[start : start + size]


def update_fleet(
    robots: Robots,
    names: Sequence[str],
    updates: Iterable[Update],
    *,
    group: int = 1,
    wait: bool = False,
    restart_s: float = 300.0,
    clock: Clock = REAL_TIME,
) -> dict[str, Outcome]:
    """Update robots, group by group; a group's robots at the same time.

    Args:
        robots: the fleet.
        names: the robots, in order.
        updates: an update for each platform.
        group: the robots of a group.
        wait: wait for robots that are absent or in use, until each is updated or one fails.
        restart_s: the longest time from a restart until the robot serves and its system is permanent.
        clock: the clock of the waits.

    Returns:
        The outcome of each robot. After a failure, no further group is begun.

    Thread: blocks the caller.
    """
    one = _OneRobot(robots, {update.platform: update for update in updates}, restart_s, clock)
    outcomes = dict.fromkeys(names, Outcome.NOT_BEGUN)
    due = list(names)
    while due:
        for some in groups_of(due, group):
            with ThreadPoolExecutor(len(some)) as pool:
                outcomes |= zip(some, pool.map(one.update, some), strict=True)
            if Outcome.FAILED in outcomes.values():
                return outcomes
        due = [name for name in names if outcomes[name] in (Outcome.ABSENT, Outcome.IN_USE)] if wait else []
        if due:
            clock.sleep(LOOK_S)
    return outcomes


@dataclass(frozen=True)
class _OneRobot:
    robots: Robots
    updates: Mapping[str, Update]
    restart_s: float
    clock: Clock

    def update(self, robot: str) -> Outcome:
        """Update a robot as far as it is behind, check it, and return the outcome."""
        try:
            return self._update(robot)
        except EALError as error:
            self.robots.tell(robot, f"failed: {error}")
            return Outcome.FAILED

    def _update(self, robot: str) -> Outcome:
        standing = self.robots.standing(robot)
        if standing is None:
            return Outcome.ABSENT if (why := self.robots.unsuited(robot)) is None else self._leave_out(robot, why)
        update = self.updates.get(standing.platform)
        if update is None:
            return self._leave_out(robot, f"there is no update for its platform {standing.platform}")
        if (user := self.robots.used_by(robot)) is not None:
            self.robots.tell(robot, f"left alone: {user} uses it")
            return Outcome.IN_USE
        stage = stage_of(standing, update)
        if stage is Stage.BEHIND and (gone := self._push(robot, update)):
            return gone
        if stage in (Stage.BEHIND, Stage.INSTALLED):
            self.robots.tell(robot, f"restarts with {update.release}")
            self.robots.restart(robot)
        if stage is not Stage.RUNNING:
            self._wait_for(robot, update.verity, standing.start if stage is not Stage.TRYING else "")
        return self._check(robot, update, standing)

    def _push(self, robot: str, update: Update) -> Outcome | None:
        try:
            self.robots.push(robot, update)
        except EALError:
            if self.robots.standing(robot) is not None:
                raise
            self.robots.tell(robot, "went away; what has arrived stays")
            return Outcome.ABSENT
        return None

    def _check(self, robot: str, update: Update, before: Standing) -> Outcome:
        problem = self.robots.problem_of(robot)
        if problem is None:
            self.robots.tell(robot, f"runs {update.release}")
            return Outcome.UPDATED
        self.robots.tell(robot, f"is not healthy: {problem}")
        if before.verity != update.verity:
            now = self._wait_for_answer(robot)
            self.robots.fall_back(robot)
            self.robots.restart(robot)
            self._wait_for(robot, before.verity, now.start)
            self.robots.tell(robot, f"runs {before.release} again")
        return Outcome.FAILED

    def _wait_for(self, robot: str, verity: str, former_start: str) -> None:
        """Wait until a robot runs a system for good.

        Raises:
            UpdateError: it started with another one, or does not come back.
        """
        end_s = self.clock.now() + self.restart_s
        while self.clock.now() < end_s:
            standing = self.robots.standing(robot)
            if standing is not None and standing.verity == verity and standing.good:
                return
            if standing is not None and standing.good and standing.start != former_start:
                raise UpdateError(f"{robot} came back with {standing.release}: the new system did not come up")
            self.clock.sleep(LOOK_S)
        raise UpdateError(f"{robot} does not serve {self.restart_s:g} s after its restart")

    def _wait_for_answer(self, robot: str) -> Standing:
        end_s = self.clock.now() + self.restart_s
        while (standing := self.robots.standing(robot)) is None:
            if self.clock.now() >= end_s:
                raise UpdateError(f"{robot} does not answer, and keeps its new system")
            self.clock.sleep(LOOK_S)
        return standing

    def _leave_out(self, robot: str, why: str) -> Outcome:
        self.robots.tell(robot, f"left out: {why}")
        return Outcome.UNSUITED


def summary(outcomes: Mapping[str, Outcome]) -> str:
    """Return the outcomes in a sentence."""
    counted = ((outcome, [name for name, one in outcomes.items() if one is outcome]) for outcome in Outcome)
    return "; ".join(
        f"{len(names)} {outcome.value}" + ("" if outcome is Outcome.UPDATED else f" ({', '.join(names)})")
        for outcome, names in counted
        if names
    )
