"""The step `wait_s`: wait for a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from typing_extensions import override

from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.scope import Scope, ScopeCheck
from eal_actors.scenario.language.values import Held, Seconds
from eal_actors.scenario.language.wording import short_number
from eal_actors.scenario.steps.base import FallibleStep


class WaitStep(FallibleStep, kind="wait_s"):
    """Wait for a time."""

    holds: ClassVar[Mapping[str, Held]] = {"wait_s": "seconds"}
    wait_s: Seconds
    """Seconds of the fleet's clock."""

    @override
    def check_values(self, check: ScopeCheck, path: YamlPath, scope: Scope) -> None:
        check.unit(self.wait_s, (*path, "wait_s"), "s", "this")
        super().check_values(check, path, scope)

    @override
    def words(self, show: Show) -> str:
        return f"wait {show(self.wait_s)} s"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        duration_s = yield from action.number(self.wait_s, "seconds", "wait_s")
        action.label = f"wait_s {short_number(duration_s)}"
        yield from action.run.sleep(action.context, duration_s)
