"""The step `log`: send a line of text to those who watch the run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from typing_extensions import override

from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import render_text
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.values import Held, Text
from eal_actors.scenario.steps.base import FallibleStep


class LogStep(FallibleStep, kind="log"):
    """Send a line of text to those who watch the run."""

    is_instant = True
    holds: ClassVar[Mapping[str, Held]] = {"log": "template"}
    log: Text

    @property
    @override
    def label(self) -> str:
        return self.kind  # the text is in an event of its own

    @override
    def words(self, show: Show) -> str:
        return f"log {show(self.log)}"

    @override
    def check_robots(self, check: RobotCheck, path: YamlPath, here: RobotScope) -> None:
        super().check_robots(check, path, here)
        check.text(self.log, (*path, "log"), here)

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        names = yield from action.read(self.log)
        action.run.log(action.context.robot_name, render_text(self.log, names))
