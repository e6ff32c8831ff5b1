"""The step `on`: every robot of a role performs steps, all robots at the same time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from typing_extensions import override

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.strict_model import Name
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import StepGroup, perform_steps, perform_within
from eal_actors.scenario.engine.frames import ExecutionContext, StepTask
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.synchronization import find_meetings
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, RobotsByRole, Scenario, Show, Steps
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Text
from eal_actors.scenario.language.wording import until_words
from eal_actors.scenario.report.timeline import StepTimeline, TimelineBuilder
from eal_actors.scenario.steps.base import BlockStep


class OnStep(BlockStep, kind="on"):
    """Perform steps with every robot of a role, or one robot, all at the same time, until the last has finished."""

    on: Name
    """The role, or the name of a robot."""
    do: Steps
    until: Text = "all"
    """`all`: ends when every robot has finished; `first`: when the first has; otherwise the name of a signal. Robots
    that have not finished by then are halted."""

    @property
    @override
    def own_role(self) -> str:
        return self.on

    @override
    def roles_at_work(self, scenario: Scenario, path: YamlPath) -> Iterator[str]:
        yield self.on

    @override
    def needs_everyone(self) -> bool:
        return False

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        roles = check.scenario.file.roles
        if self.on not in roles:
            check.report((*path, "on"), f"unknown role '{self.on}'{did_you_mean(self.on, roles)}")
        if scope.role is not None:
            check.report((*path, "on"), f"is inside 'on: {scope.role}'; a robot performs one 'on' at a time", key=True)
        check.until(self.until, path)

    @override
    def scope_inside(self, check: ScopeCheck, scope: Scope) -> Scope:
        return replace(scope.inside(), role=scope.role or self.on, is_beside=True)

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        return check.enter(self.on, here)

    @override
    def shared_robots(self, scenario: Scenario, path: YamlPath, roles: RobotsByRole) -> Iterator[Problem]:
        return iter(())

    @override
    def block_words(self, show: Show) -> str:
        return f"on {self.on}" + until_words(self.until)

    @override
    def timeline(self, builder: TimelineBuilder, path: YamlPath, robots: tuple[str, ...]) -> StepTimeline:
        robots = tuple(builder.roles[self.on])
        return robots, builder.children(self, path, robots)

    @override
    def count_calls(self, scenario: Scenario, path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        return scenario.count_calls(self.do, (*path, "do"), live.get(self.on, 0), live)

    @override
    def perform(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        frame, inside = context.frame, context.inside(self.on_failure)
        meets = find_meetings(frame, self.do)
        work = partial(perform_steps, run, self.do, f"{path}.do")
        tasks = []
        for slot in run.slots_of(self.on, context):
            task = StepTask(context.task, slot, meets=meets)
            here = replace(inside, task=task, slot=slot, role=self.on)
            # The limit is each robot's own.
            tasks.append((task, perform_within(run, here, self, self.timeout_s, path, meets, work)))
        yield from StepGroup(run, context, self.until).perform(tasks)
