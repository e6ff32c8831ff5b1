"""The step `signal`: give a signal, with a value."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, ClassVar

from typing_extensions import override

from eal_actors.kernel.strict_model import Name
from eal_actors.scenario.engine.action import StepAction
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import render
from eal_actors.scenario.language.scenario import Show
from eal_actors.scenario.language.values import Held, Value
from eal_actors.scenario.report.events import Signalled
from eal_actors.scenario.report.records import to_view
from eal_actors.scenario.steps.base import FallibleStep


class SignalStep(FallibleStep, kind="signal"):
    """Give a signal to all who wait for it, now or later."""

    is_instant = True
    holds: ClassVar[Mapping[str, Held]] = {"value": "template"}
    signal: Name
    value: Value | None = None
    """The value that `wait_for` saves; defaults to the robot's name."""

    @override
    def given_signals(self) -> Iterable[str]:
        return (self.signal,)

    @override
    def words(self, show: Show) -> str:
        return f"give signal {self.signal}"

    @override
    def attempt(self, action: StepAction) -> Coroutine:
        robot = action.context.robot_name
        value: Any = robot
        if self.value is not None:
            names = yield from action.read(self.value)
            value = render(self.value, names)
        frame, name = action.context.frame, self.signal
        while True:
            count = action.run.signals.give(frame, name, value)
            event = (robot, f"{frame.prefix}{name}", count, to_view(value))
            action.run.emit(lambda time_s, event=event: Signalled(time_s, *event))  # type: ignore[misc]
            if frame.outer is None or name not in frame.signals:
                return
            frame, name = frame.outer, frame.signals[name]
