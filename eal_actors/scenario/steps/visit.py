"""The step `visit`: drive to places one after another, and perform steps at each."""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, Final

from typing_extensions import override

from eal_actors.actors.future import Future
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.computing import compute
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_step, perform_steps, record_skip
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.engine.python_functions import StepFunction
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, Scenario, Show, Step, Steps
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.static_values import StaticLoop
from eal_actors.scenario.language.values import Held
from eal_actors.scenario.steps.for_ import LoopValues
from eal_actors.scenario.steps.loop import LoopStep
from eal_actors.scenario.steps.places import (
    BASE,
    Place,
    begin_trip,
    check_driving,
    known_places,
    place_words,
    places_of,
)

PLACE: Final = "place"
"""The variable that holds the present place."""


class VisitStep(LoopStep, kind="visit"):
    """Drive to places one after another, round obstacles and other robots, and perform steps at each."""

    holds: ClassVar[Mapping[str, Held]] = {"visit": "template"}
    visit: LoopValues
    """The places, each a name of the fleet's world, or [x_m, y_m], or [x_m, y_m, yaw_deg]; or `${...}` that evaluates
    to a list of them. In the steps, `${place}` is the present one."""
    split: bool = False
    """The robots of the role divide the places among themselves, in their order; otherwise each visits all."""
    do: Steps = ()

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        return super().children() if self.do else ()

    # Checks.

    @override
    def check_placement(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        super().check_placement(check, path, scope)
        if scope.role is None:
            check.report((*path, "visit"), "which robot? 'visit' must be in the 'do' of an 'on'", key=True)
        if PLACE in scope.loops:
            check.report((*path, "visit"), f"'{PLACE}' is the variable of a loop around this one already", key=True)

    @override
    def loop(self) -> tuple[str, object]:
        return PLACE, self.visit

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        check_driving(check, (*path, "visit"), here)
        for _ in known_places(check, self.visit, (*path, "visit"), here):
            pass
        super().check_robots(check, path, here)

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        is_plain = isinstance(self.visit, tuple) and not expressions_in(self.visit)
        values = self.visit if is_plain and isinstance(self.visit, tuple) else None
        return replace(here, values=here.values.within(StaticLoop(PLACE, values)))

    # Wording and planning.

    @override
    def block_words(self, show: Show) -> str:
        return f"visit {show(self.visit)}" + (", divided among the robots" if self.split else "")

    @override
    def count_calls(self, scenario: Scenario, path: YamlPath, robots: int | None, live: Mapping[str, int]) -> int:
        visitors = 1 if self.split else robots or 0
        each = visitors + scenario.count_calls(self.do, (*path, "do"), visitors, live)
        return each * (self.passes(scenario) or 0)

    # Execution.

    @override
    def may_repeat(self, functions: Mapping[str, StepFunction], info: ResourceInfo | None, command: str | None) -> bool:
        return True  # it drives to a place

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        here, needed = f"{path}.visit", expressions_in(self.visit)
        places: list[Place] | None = yield from compute(run, context, self, here, "visit", needed, self._places)
        inside = context.inside(self.on_failure)
        for place in places or ():
            if not run.may_begin(context):
                return
            yield from run.next_pass()
            if (yield from self._go(run, inside, here, place)):
                value = place if isinstance(place, str) else list(place)
                yield from perform_steps(run, self.do, f"{path}.do", inside.in_loop(PLACE, value))

    def _go(
        self, run: RunContext, context: ExecutionContext, path: str, place: Place
    ) -> Generator[Future[Any], None, bool]:
        """Drive to a place; return whether the steps there follow: a robot that rejoins may meet others among them."""
        label = f"visit {place_words(place)}"
        if run.losses is not None and run.losses.leaves_out(context):
            record_skip(run, context, self, label, path)
            return True
        make = partial(StepAction, run, context, label, partial(self._drive, place))
        is_there = yield from perform_step(run, context, self, path, make)
        return is_there or (run.losses is not None and run.losses.leaves_out(context))

    def _places(self, names: Namespace) -> list[Place]:
        places = places_of(render(self.visit, names))
        if not self.split:
            return places
        index, count = (int(names.variables[fact]) for fact in ("index", "count"))  # type: ignore[call-overload]
        return places[index * len(places) // count : (index + 1) * len(places) // count]

    def _drive(self, place: Place, action: StepAction) -> Coroutine:
        run, context = action.run, action.context
        action.resource = BASE
        context.task.touch(BASE)
        trip = begin_trip(run, context.required_robot.handle, place, context.frame.timeout_s)
        yield from run.wait(context, trip)
        trip.get()
