"""Who takes part in a run: robots, the places they fill, and the lines of steps that they go through."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.model import OnFailure
from eal_actors.scenario.report import ErrorReport, RobotOutcome, RobotReport
from eal_actors.scenario.scenario import Scenario


@dataclass(eq=False)
class RobotRun:
    """A robot in a run.

    Attributes:
        handle: the robot.
        outcome: None while it takes part, or may come to.
        error: why it failed or left.
        is_seated: whether it has ever had a place in a role.
        pending: what its steps wait for.
    """

    handle: RobotHandle
    outcome: RobotOutcome | None = None
    error: BaseException | None = None
    is_seated: bool = False
    pending: dict[Future[Any], None] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.handle.name

    def end(self, outcome: RobotOutcome, error: BaseException | None = None) -> None:
        """Take no part any more."""
        self.outcome = outcome
        self.error = self.error or error

    def report(self) -> RobotReport:
        """Return how it fared."""
        return RobotReport(
            outcome=self.outcome or "aborted", error=ErrorReport.of(self.error) if self.error is not None else None
        )


@dataclass(eq=False)
class Seat:
    """A place in a role, which one robot at a time fills.

    Attributes:
        role: the role.
        index: its number in the role, from 0.
        count: how many places the role has.
        robot: who fills it.
        variables: those of the place: who takes it over finds them as they were.
        parts: the same in scenarios that are carried out as parts of the main one.
        past: who has filled it before.
    """

    role: str
    index: int
    count: int
    robot: RobotRun
    variables: dict[str, object] = field(default_factory=dict)
    parts: dict[Unit, dict[str, object]] = field(default_factory=dict)
    past: list[RobotRun] = field(default_factory=list)

    def variables_in(self, unit: Unit) -> dict[str, object]:
        """Return its variables in a scenario: each has its own."""
        return self.variables if unit.outer is None else self.parts.setdefault(unit, {})

    def facts(self, role: str, unit: Unit) -> dict[str, object]:
        """Return what expressions of a scenario may ask about it, where the role goes by a name."""
        index, count = (self.index, self.count) if unit.seat is None else (0, 1)
        return {"robot": self.robot.name, "role": role, "index": index, "count": count}


class Task:
    """A line of steps that goes on beside others.

    Args:
        parent: the line that waits for it; None for the main one.
        seat: whose steps they are; None outside of `on`.
        branch: the branch of a `parallel`.
        meets: the meetings among its steps.

    Attributes:
        children: the lines that it waits for.
        pending: what it waits for.
        touched: the resources of its robot that it, or a line inside it, has called.
        touches_all: it may have called any.
        is_stopped: nothing new is begun in it.
        steps_taken: the number of the last single step that it took while the run was paused.
    """

    def __init__(
        self,
        parent: Task | None = None,
        seat: Seat | None = None,
        branch: str | None = None,
        meets: frozenset[Hashable] = frozenset(),
    ) -> None:
        self.parent = parent
        self.seat = seat
        self.branch = branch
        self.meets = meets
        self.children: dict[Task, None] = {}
        self.pending: dict[Future[Any], None] = {}
        self.is_stopped = False
        self.steps_taken = 0
        self.touched: dict[str, None] = {}
        self.touches_all = False

    @property
    def name(self) -> str:
        """Who it is, for messages."""
        if self.seat is not None:
            return self.seat.robot.name
        return f"branch '{self.branch}'" if self.branch is not None else "the scenario"

    def touch(self, resource: str | None) -> None:
        """Note that it calls a resource; None stands for any."""
        task: Task | None = self
        while task is not None:
            if resource is None:
                task.touches_all = True
            else:
                task.touched[resource] = None
            task = task.parent

    def stop(self) -> None:
        """Begin nothing more in it, and cancel what is under way."""
        self.is_stopped = True
        for child in list(self.children):
            child.stop()
        for future in list(self.pending):
            future.cancel()

    def robots(self) -> Iterator[RobotRun]:
        """Yield the robots at work in it."""
        if self.seat is not None:
            yield self.seat.robot
        for child in self.children:
            yield from child.robots()


class Unit:
    """A scenario in the course of being carried out: the main one, or one of its parts.

    Args:
        scenario: the scenario.
        roles: its roles by the names of the main scenario.
        parameters: the values of its parameters.
        prefix: path of the step that carries it out.
        outer: the unit that it is part of; None for the main one.
        signals: its signals to those of the outer unit that are given with them.
        seat: who carries it out alone, in all of its roles; None where its roles have robots of their own.

    Attributes:
        variables: those of the run, parameters included.
        meets: the meetings in lists of steps, found once.
    """

    def __init__(
        self,
        scenario: Scenario,
        roles: Mapping[str, str],
        parameters: Mapping[str, object],
        prefix: str = "",
        outer: Unit | None = None,
        signals: Mapping[str, str] | None = None,
        seat: Seat | None = None,
    ) -> None:
        self.scenario = scenario
        self.roles = roles
        self.prefix = prefix
        self.outer = outer
        self.signals = signals or {}
        self.seat = seat
        self.variables: dict[str, object] = dict(parameters)
        self.meets: dict[int, frozenset[Hashable]] = {}

    @property
    def timeout_s(self) -> float | None:
        """Deadline of a call that gives none."""
        own = self.scenario.file.timeout_s
        return own if own is not None or self.outer is None else self.outer.timeout_s


@dataclass(frozen=True, slots=True)
class Context:
    """Where a step is performed.

    Attributes:
        task: the line of steps it belongs to.
        unit: the scenario it belongs to.
        seat: whose step it is; None outside of `on`.
        role: the seat's role by the unit's name for it.
        loops: the variables of the loops around it.
        policy: what blocks around it say of failures; None if they say nothing.
        is_finally: failures stop nothing.
    """

    task: Task
    unit: Unit
    seat: Seat | None = None
    role: str | None = None
    loops: Mapping[str, object] = field(default_factory=dict)
    policy: OnFailure | None = None
    is_finally: bool = False

    @property
    def robot(self) -> RobotRun | None:
        """Who fills the seat now."""
        return self.seat.robot if self.seat is not None else None

    @property
    def acting(self) -> RobotRun:
        """Who fills the seat now, for steps that nobody else can do.

        Raises:
            ScenarioError: there is no seat, which is refused when the file is read.
        """
        if self.seat is None:
            raise ScenarioError("there is no robot here to do it")
        return self.seat.robot

    @property
    def robot_name(self) -> str | None:
        """The name of who fills the seat now."""
        return self.seat.robot.name if self.seat is not None else None

    @property
    def branch(self) -> str | None:
        """The innermost branch of a `parallel`."""
        task: Task | None = self.task
        while task is not None and task.branch is None:
            task = task.parent
        return task.branch if task is not None else None

    def inside(self, policy: OnFailure | None) -> Context:
        """Return the context of a block's steps."""
        return self if policy is None else replace(self, policy=policy)

    def in_loop(self, name: str, value: object) -> Context:
        """Return the context of one pass of a loop."""
        return replace(self, loops={**self.loops, name: value})

    def effective_policy(self, own: OnFailure | None) -> OnFailure:
        """Return what happens when a step fails: what it, its blocks, its role or its file say, in this order."""
        if own is not None:
            return own
        if self.policy is not None:
            return self.policy
        file = self.unit.scenario.file
        section = file.roles.get(self.role) if self.role is not None else None
        return section.on_failure if section is not None and section.on_failure is not None else file.on_failure
