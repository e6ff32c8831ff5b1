"""The step `formation`: the robots of a role take up the places of a shape."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from typing_extensions import override

from eal_actors.facade.traffic.formations import formation_goals
from eal_actors.facade.traffic.travelling import JOURNEY_TIMEOUT_S
from eal_actors.kernel.errors import EALError
from eal_actors.kernel.strict_model import Name, StrictModel
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, Scenario, Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Text, Value
from eal_actors.scenario.report.timeline import StepTimeline, TimelineBuilder
from eal_actors.scenario.steps.base import TimedStep
from eal_actors.scenario.steps.places import check_driving, known_places, number_of, place_of


class FormationArguments(StrictModel):
    """A shape, and the robots that form it."""

    role: Name
    shape: Text
    """line, column, grid, circle or wedge."""
    spacing_m: Value
    """Distance between neighbours."""
    at: Value = (0.0, 0.0)
    """The centre: the name of a place of the fleet's world, or [x_m, y_m], or [x_m, y_m, yaw_deg]. The shape faces the
    place's heading."""


class FormationStep(TimedStep, kind="formation"):
    """Let the robots of a role take up the places of a shape, all together and without collisions."""

    moves_its_role = True
    formation: FormationArguments

    @override
    def roles_at_work(self, scenario: Scenario, path: YamlPath) -> Iterator[str]:
        yield self.formation.role

    @override
    def templates(self) -> Iterable[tuple[Keys, object]]:
        values = ((key, getattr(self.formation, key)) for key in ("shape", "spacing_m", "at"))
        return (*super().templates(), *((("formation", key), value) for key, value in values))

    # Checks.

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        role, roles = self.formation.role, check.scenario.file.roles
        if role not in roles:
            check.report((*path, "formation", "role"), f"unknown role '{role}'{did_you_mean(role, roles)}")
        if scope.role is not None:
            check.report((*path, "formation"), "must be outside of 'on': it moves all robots of its role", key=True)

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        super().check_robots(check, path, here)
        where, inside = (*path, "formation"), check.enter(self.formation.role, here)
        check_driving(check, where, inside)
        for _ in known_places(check, (self.formation.at,), (*where, "at"), here):
            pass
        robots = dict.fromkeys(check.regular(inside), (0.0, 0.0))
        wanted = (self.formation.shape, self.formation.spacing_m)
        if robots and here.are_known(expressions_in(wanted)):
            for _, names in check.combinations(expressions_in(wanted), where, here):
                try:
                    self._goals(robots, (0.0, 0.0, 0.0), names)
                except EALError as error:
                    check.report(here, where, error.message)
            self._check_room(check, where, here, robots)

    def _check_room(
        self, check: RobotCheck, where: YamlPath, here: RobotScope, robots: Mapping[str, tuple[float, float]]
    ) -> None:
        """Report goals outside the room, as far as they are known before the run."""
        expressions = expressions_in((self.formation.shape, self.formation.spacing_m, self.formation.at))
        if not here.are_known(expressions):
            return
        for _, names in check.combinations(expressions, where, here):
            try:
                centre = check.require_place(place_of(render(self.formation.at, names)))
            except EALError:
                return  # it is reported
            try:
                for goal in self._goals(robots, centre, names).values():
                    check.require_place(goal)
            except EALError as error:
                check.report(here, where, error.message)

    def _goals(
        self, starts: Mapping[str, tuple[float, float]], centre: tuple[float, float, float], names: Namespace
    ) -> dict[str, tuple[float, float, float]]:
        spacing_m = number_of(render(self.formation.spacing_m, names), "spacing_m")
        return formation_goals(starts, str(render(self.formation.shape, names)), spacing_m, centre)

    # Wording, planning and execution.

    @override
    def words(self, show: Show) -> str:
        wanted = self.formation
        return f"{wanted.role} form a {show(wanted.shape)} at {show(wanted.at)}, {show(wanted.spacing_m)} m apart"

    @property
    @override
    def label(self) -> str:
        return f"formation {self.formation.role} {self.formation.shape}"

    @override
    def timeline(self, builder: TimelineBuilder, path: YamlPath, robots: tuple[str, ...]) -> StepTimeline:
        return tuple(builder.roles[self.formation.role]), ()

    @override
    def count_calls(self, scenario: Scenario, path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        return live.get(self.formation.role, 0)

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        run, context = action.run, action.context
        names = run.namespace(context)
        action.label = f"formation {self.formation.role} {render(self.formation.shape, names)}"
        slots = run.slots_of(self.formation.role, context)
        action.role = next((slot.role for slot in slots), None)
        if not slots:
            return
        robots = {slot.robot.name: slot.robot.handle for slot in slots}
        context.task.touch(None)
        poses = run.fleet.read(robots.values(), "Pose")
        yield from run.wait(context, poses)
        starts = {name: (float(pose.value[0]), float(pose.value[1])) for name, pose in poses.get().items()}
        centre = run.fleet.pose_at(place_of(render(self.formation.at, names)))
        goals: dict[Any, Any] = {robots[name]: goal for name, goal in self._goals(starts, centre, names).items()}
        journey = run.fleet.go_to(goals, timeout_s=self.deadline_s(context, names) or JOURNEY_TIMEOUT_S)
        yield from run.wait(context, journey)
        journey.get()
