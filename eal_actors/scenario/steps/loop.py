"""The family of loops: what `for`, `repeat` and `while` have in common."""

from __future__ import annotations

from collections.abc import Iterable

from typing_extensions import override

from eal_actors.kernel.yaml_tree import format_path
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.scenario import Scenario
from eal_actors.scenario.language.scope import LoopVariable, Scope, ScopeCheck
from eal_actors.scenario.language.static_values import value_of_parameters
from eal_actors.scenario.steps.base import BlockStep


class LoopStep(BlockStep):
    """A step that performs steps several times."""

    def loop(self) -> tuple[str, object]:
        """Return the variable, and its values: all, their number, or a text with `${...}`; None if the run tells."""
        raise NotImplementedError

    @override
    def scope_inside(self, check: ScopeCheck, scope: Scope) -> Scope:
        name, values = self.loop()
        is_static = values is not None and check.is_static(values, scope)
        return scope.within(LoopVariable(name, _count(values), is_static))

    @override
    def passes(self, scenario: Scenario) -> int | None:
        _, values = self.loop()
        return _count(values if isinstance(values, tuple) else value_of_parameters(scenario, values))

    def perform_passes(
        self, run: RunContext, context: ExecutionContext, path: str, name: str, values: Iterable[object]
    ) -> Coroutine:
        """Perform the steps inside once for each value of the variable."""
        inside = context.inside(self.on_failure)
        for value in values:
            if not run.may_begin(context):
                return
            yield from run.next_pass()
            for keys, steps in self.children():
                yield from perform_steps(run, steps, f"{path}.{format_path(keys)}", inside.in_loop(name, value))


def _count(values: object) -> int | None:
    if isinstance(values, tuple | list):
        return len(values)
    return values if isinstance(values, int) else None
