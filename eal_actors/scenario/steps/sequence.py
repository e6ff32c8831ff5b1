"""The step `sequence`: perform steps one after the other, with a common time limit or failure policy."""

from __future__ import annotations

from collections.abc import Sequence

from typing_extensions import override

from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.executor import perform_steps
from eal_actors.scenario.engine.frames import ExecutionContext
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.scenario import Keys, Step, Steps
from eal_actors.scenario.steps.base import BlockStep


class SequenceStep(BlockStep, kind="sequence"):
    """Perform steps one after the other, with common settings such as a time limit."""

    sequence: Steps

    @override
    def children(self) -> Sequence[tuple[Keys, tuple[Step, ...]]]:
        return ((("sequence",), self.sequence),)

    @override
    def perform_inside(self, run: RunContext, context: ExecutionContext, path: str) -> Coroutine:
        return perform_steps(run, self.sequence, f"{path}.sequence", context.inside(self.on_failure))
