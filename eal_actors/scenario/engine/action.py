"""A step as one robot performs it: what the work of a step kind reads and reports."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from eal_actors.actors.future import Future
from eal_actors.scenario.engine.context import RunContext
from eal_actors.scenario.engine.frames import ExecutionContext, Participant
from eal_actors.scenario.engine.loop import Coroutine
from eal_actors.scenario.language.expressions.evaluation import Namespace, expressions_in, render
from eal_actors.scenario.language.expressions.grammar import Expression
from eal_actors.scenario.language.values import Wanted, checked_number


@dataclass(eq=False)
class StepAction:
    """A step as one robot performs it, or no robot.

    Attributes:
        label: the step in records, for people.
        command: the text argument of the call, or None.
        is_begun: it has gone further than evaluating its expressions.
        began_s: when it began, in seconds since the run's start, if it had to wait for others first.
        robot: the one that performs it, or None; inside a block, a spare may take over.
        late: outside of `on`, the robots that were at work when its time was up.
        role: outside of `on`, the role whose robots it moves, by its name in the main scenario; None for none.
        path: where the record keeps its readings; None if the step itself is in the record.
    """

    run: RunContext
    context: ExecutionContext
    label: str
    _work: Callable[[StepAction], Coroutine]
    resource: str | None = None
    command: str | None = None
    is_begun: bool = True
    began_s: float | None = None
    answer: object = None
    late: Sequence[Participant] = ()
    role: str | None = None
    path: str | None = None
    robot: Participant | None = field(init=False)

    def __post_init__(self) -> None:
        self.robot = self.context.robot

    def attempt(self) -> Coroutine:
        """Perform the step once; raise EALError if the attempt failed."""
        return self._work(self)

    def read(self, value: object) -> Generator[Future[Any], None, Namespace]:
        """Return the namespace for the `${...}` in a value; raise EALError if a reading failed."""
        return self.evaluate(expressions_in(value))

    def evaluate(self, expressions: Iterable[Expression]) -> Generator[Future[Any], None, Namespace]:
        """Return the namespace for expressions; raise EALError if a reading failed."""
        return self.run.read(self.context, expressions, path=self.path)

    def number(self, value: object, wanted: Wanted, what: str) -> Generator[Future[Any], None, float]:
        """Return a number that may be an expression; raise EALError if a reading failed or it is out of range."""
        names = yield from self.read(value)
        return checked_number(render(value, names), wanted, what)
