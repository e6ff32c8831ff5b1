"""The participants of a run: robots, the slots that they fill, scenarios under way, and tasks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Hashable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.actors.handles import RobotHandle
from eal_actors.device.info import ResourceType
from eal_actors.kernel.errors import EALError, ScenarioError, UnavailableError
from eal_actors.scenario.language.scenario import Scenario, Step
from eal_actors.scenario.language.values import OnFailure, OnLost, RetryPolicy
from eal_actors.scenario.report.summary import LossReport, RobotOutcome


@dataclass(eq=False)
class Participant:
    """A robot in a run.

    Attributes:
        outcome: None while it takes part, or is in reserve.
        error: why it ended; before that, the failure of a step in the `finally` of a part.
        has_taken_part: it has ever filled a slot.
        pending: the futures that its steps wait for, each with the `lost_after_s` of its step.
        losses: when it was lost, and back.
        is_given_up: it is lost for so long that its steps fail.
        is_rejoining: it was lost, and leaves out its steps up to its next meeting.
    """

    handle: RobotHandle
    outcome: RobotOutcome | None = None
    error: BaseException | None = None
    has_taken_part: bool = False
    pending: dict[Future[Any], float | None] = field(default_factory=dict)
    losses: list[LossReport] = field(default_factory=list)
    is_given_up: bool = False
    is_rejoining: bool = False

    @property
    def is_lost(self) -> bool:
        """Whether it is out of reach."""
        return bool(self.losses) and self.losses[-1].back_s is None

    @property
    def name(self) -> str:
        """The robot's name."""
        return self.handle.name

    def end(self, outcome: RobotOutcome, error: BaseException | None = None) -> None:
        """End its part in the run."""
        self.outcome = outcome
        self.error = self.error or error

    def begin_halt(self, timeout_s: float, only: Collection[str] | None) -> list[tuple[str, Future[int]]]:
        """Halt its actuators, or only these; return the name and the confirmation of each.

        What this program may not halt it may not move either.
        """
        halts: list[tuple[str, Future[int]]] = []
        for name, resource in self.handle.items():
            if only is not None and name not in only:
                continue
            try:
                moves = ResourceType.ACTUATOR in resource.info.types and resource.denied("halt") is None
            except UnavailableError:  # it was never up, so it has never moved
                continue
            if moves:
                halts.append((name, resource.halt(timeout_s=timeout_s)))
        return halts


@dataclass(eq=False)
class RoleSlot:
    """A slot of a role, which one robot at a time fills.

    Attributes:
        index: its number in the role, from 0.
        variables: its variables; they stay when another robot takes over.
        part_variables: its variables in scenarios that run as parts of the main one.
        past: the robots that were in it before.
    """

    role: str
    index: int
    count: int
    robot: Participant
    variables: dict[str, object] = field(default_factory=dict)
    part_variables: dict[Frame, dict[str, object]] = field(default_factory=dict)
    past: list[Participant] = field(default_factory=list)

    def variables_in(self, frame: Frame) -> dict[str, object]:
        """Return its variables in a scenario: each scenario has its own."""
        return self.variables if frame.outer is None else self.part_variables.setdefault(frame, {})

    def facts(self, role: str, frame: Frame) -> dict[str, object]:
        """Return the built-in variables of expressions, for a scenario that calls the role by this name."""
        index, count = (self.index, self.count) if frame.slot is None else (0, 1)
        return {"robot": self.robot.name, "role": role, "index": index, "count": count}


@dataclass(eq=False)
class AttemptMeetings:
    """How often the attempts of a block that one robot repeats have met others, by the key of the meeting."""

    before: Counter[Hashable] = field(default_factory=Counter)
    now: Counter[Hashable] = field(default_factory=Counter)

    def begin(self) -> AttemptMeetings:
        """Begin an attempt."""
        self.before |= self.now
        self.now = Counter()
        return self


@dataclass(eq=False)
class StepTask:
    """A task: steps that run one after the other, beside those of other tasks.

    Attributes:
        parent: the task that waits for it; None for the main one.
        slot: of the robot whose steps they are; None outside of `on`.
        repeats: the block that they are an attempt of, if a failure repeats it.
        meetings: the meetings of the attempts of that block, if one robot repeats it.
        touched: the resources of its robot that it, or a task inside it, has called.
        touches_all: it may have called any resource.
        is_stopped: it begins no more steps.
        steps_taken: the number of the last single step that it took while the run was paused.
        error: the failure that ended this attempt of a block, or None.
    """

    parent: StepTask | None = None
    slot: RoleSlot | None = None
    branch: str | None = None
    meets: frozenset[Hashable] = frozenset()
    repeats: object = None
    meetings: AttemptMeetings | None = None
    error: EALError | None = field(default=None, init=False)
    children: dict[StepTask, None] = field(default_factory=dict, init=False)
    pending: dict[Future[Any], None] = field(default_factory=dict, init=False)
    is_stopped: bool = field(default=False, init=False)
    steps_taken: int = field(default=0, init=False)
    touched: dict[str, None] = field(default_factory=dict, init=False)
    touches_all: bool = field(default=False, init=False)

    @property
    def name(self) -> str:
        """Its name in messages."""
        if self.slot is not None:
            return self.slot.robot.name
        return f"branch '{self.branch}'" if self.branch is not None else "the scenario"

    def had_met(self, key: Hashable) -> bool:
        """Return whether an earlier attempt of a block around it had met the others, who have gone on since."""
        return any(found.now[key] < found.before[key] for found in self._attempts())

    def note_meeting(self, key: Hashable) -> None:
        """Count a meeting in the attempts of blocks around it."""
        for found in self._attempts():
            found.now[key] += 1

    def _attempts(self) -> Iterator[AttemptMeetings]:
        task: StepTask | None = self
        while task is not None:
            if task.meetings is not None:
                yield task.meetings
            task = task.parent

    def touch(self, resource: str | None) -> None:
        """Record a call of a resource; None means any resource."""
        task: StepTask | None = self
        while task is not None:
            if resource is None:
                task.touches_all = True
            else:
                task.touched[resource] = None
            task = task.parent

    def stop(self) -> None:
        """Begin no more steps, and cancel those under way."""
        self.is_stopped = True
        for child in list(self.children):
            child.stop()
        for future in list(self.pending):
            future.cancel()

    def fail(self, error: EALError) -> None:
        """End this attempt of a block."""
        self.error = self.error or error
        self.stop()

    def robots(self) -> Iterator[Participant]:
        """Yield the robots at work in it."""
        if self.slot is not None:
            yield self.slot.robot
        for child in self.children:
            yield from child.robots()


@dataclass(eq=False)
class Frame:
    """A scenario under way: the main one, or a part of another.

    Attributes:
        roles: its roles by the names of the main scenario.
        variables: those of the run, parameters included.
        prefix: path of the step that runs it.
        outer: the frame that it is part of; None for the main one.
        signals: its signals that are forwarded to the outer frame, by their names there.
        slot: of the robot that runs it alone, in all of its roles; None if its roles have robots of their own.
        meets: by its id, each step of the scenario and the meetings in it, found once.
    """

    scenario: Scenario
    roles: Mapping[str, str]
    variables: dict[str, object]
    prefix: str = ""
    outer: Frame | None = None
    signals: Mapping[str, str] = field(default_factory=dict)
    slot: RoleSlot | None = None
    meets: dict[int, frozenset[Hashable]] = field(default_factory=dict, init=False)

    @property
    def timeout_s(self) -> float | None:
        """The default deadline of a call."""
        own = self.scenario.file.timeout_s
        return own if own is not None or self.outer is None else self.outer.timeout_s


@dataclass(frozen=True, slots=True)
class ExecutionContext:
    """The context in which a step is performed.

    Attributes:
        slot: of the robot whose step it is; None outside of `on`.
        role: the slot's role by the frame's name for it.
        loops: the variables of the loops around it.
        policy: the failure policy of the blocks around it; None if they have none.
        attempt: the attempt of the block around it that a failure repeats; None if the policy is another one.
        is_finally: it belongs to `finally`, where failures stop nothing.
        lost_after_s: time out of reach after which it fails; None for that of the run.
    """

    task: StepTask
    frame: Frame
    slot: RoleSlot | None = None
    role: str | None = None
    loops: Mapping[str, object] = field(default_factory=dict)
    policy: OnFailure | None = None
    attempt: StepTask | None = None
    is_finally: bool = False
    lost_after_s: float | None = None

    @property
    def robot(self) -> Participant | None:
        """The robot that is in the slot now."""
        return self.slot.robot if self.slot is not None else None

    @property
    def required_robot(self) -> Participant:
        """The robot in the slot; raise ScenarioError without a slot, in files that the loader refuses."""
        if self.slot is None:
            raise ScenarioError("the step needs a robot, but is outside of 'on'")
        return self.slot.robot

    @property
    def robot_name(self) -> str | None:
        """The name of the robot that is in the slot now."""
        return self.slot.robot.name if self.slot is not None else None

    @property
    def branch(self) -> str | None:
        """The innermost branch of a `parallel`."""
        task: StepTask | None = self.task
        while task is not None and task.branch is None:
            task = task.parent
        return task.branch if task is not None else None

    def inside(self, policy: OnFailure | None) -> ExecutionContext:
        """Return the context of a block's steps; with a RetryPolicy, a failure of one repeats the block."""
        if policy is None:
            return self
        is_retry = isinstance(policy, RetryPolicy)
        return replace(self, policy=None if is_retry else policy, attempt=self.attempt if is_retry else None)

    def of(self, step: Step) -> ExecutionContext:
        """Return the context of a step, with its own patience for lost robots."""
        return self if step.lost_after_s is None else replace(self, lost_after_s=step.lost_after_s)

    def in_loop(self, name: str, value: object) -> ExecutionContext:
        """Return the context of one pass of a loop."""
        return replace(self, loops={**self.loops, name: value})

    @property
    def on_lost(self) -> OnLost | None:
        """The policy if its robot is lost: that of its role, or its file."""
        if self.role is None or self.is_finally:
            return None
        file = self.frame.scenario.file
        section = file.roles.get(self.role)  # outside of its own `on`, a part has no role of this name
        return (section.on_lost if section is not None else None) or file.on_lost

    def effective_policy(self, own: OnFailure | None) -> OnFailure:
        """Return the failure policy: that of the step, its blocks, its role, or its file, in this order."""
        if own is not None:
            return own
        if self.policy is not None:
            return self.policy
        file = self.frame.scenario.file
        section = file.roles.get(self.role) if self.role is not None else None
        return section.on_failure if section is not None and section.on_failure is not None else file.on_failure
