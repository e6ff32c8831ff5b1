"""The step `repeat`: perform steps several times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import ClassVar

from typing_extensions import override

from eal_actors.kernel.errors import EALError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.engine.computing import compute_count
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import evaluate
from eal_actors.scenario.language.expressions.grammar import parse_template
from eal_actors.scenario.language.robot_check import RobotCheck, RobotScope
from eal_actors.scenario.language.scenario import Keys, Show, Steps
from eal_actors.scenario.language.static_values import StaticLoop, TooManyCombinationsError
from eal_actors.scenario.language.values import INDEX, Count, Held
from eal_actors.scenario.steps.loop import LoopStep


class RepeatStep(LoopStep, kind="repeat"):
    """Perform steps several times; `${i}` is the number of the round, from 0."""

    holds: ClassVar[Mapping[str, Held]] = {"repeat": "count"}
    repeat: Count
    do: Steps

    @override
    def loop(self) -> tuple[str, object]:
        return INDEX, self.repeat

    @override
    def robots_inside(self, check: RobotCheck, path: YamlPath, here: RobotScope, keys: Keys) -> RobotScope:
        values = range(self.repeat) if isinstance(self.repeat, int) else self._static_range(self.repeat, here)
        return replace(here, values=here.values.within(StaticLoop(INDEX, values)))

    def _static_range(self, text: str, here: RobotScope) -> Sequence[object] | None:
        """Return the numbers of the passes, if their count is known and the same for every robot."""
        expression = parse_template(text).whole
        if expression is None or not here.values.is_known(expression) or here.values.needs_facts([expression]):
            return None
        passes = 0
        with suppress(TooManyCombinationsError):  # reported by the check of the number, as are errors
            for names in here.values.combinations([expression]):
                with suppress(EALError):
                    count = evaluate(expression, names)
                    passes = max(passes, count if isinstance(count, int) else 0)
        return range(passes)

    @override
    def block_words(self, show: Show) -> str:
        return f"repeat {show(self.repeat)} times"

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        count = yield from compute_count(run, context, self, path, self.repeat, "repeat")
        yield from self.perform_passes(run, context, path, INDEX, range(count or 0))
