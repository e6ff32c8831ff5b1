"""Evaluation of expressions, and of texts with `${...}` in them. `$${` is a literal `${`.

`simpleeval` evaluates expressions; Python's own `eval` is never used.

Size and work are bounded. The size of a value is the number of its characters and of its values, lists included. The
items of a list inside a list count each time that the list is referenced. Otherwise a few lines such as
`b: [a, a, a]`, `c: [b, b, b]` make a value that fills the memory. An operation of an expression costs the size of its
result.
"""

from __future__ import annotations

import ast
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from simpleeval import InvalidExpression, SimpleEval

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ScenarioError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.language.expressions.functions import (
    CONSTANTS,
    FUNCTIONS,
    MAX_ITEMS,
    OPERATORS,
    RefusalError,
    as_text,
)
from eal_actors.scenario.language.expressions.grammar import (
    READINGS,
    Expression,
    RobotReading,
    parse_expression,
    parse_template,
)

MAX_SIZE: Final = 100_000
"""Maximum size of a value, and maximum work of one expression."""
MAX_WORK: Final = 10_000_000
"""Maximum work of the expressions that are evaluated before a run."""
MAX_LEVELS: Final = 40
"""Maximum nesting of lists."""
SCALARS: Final = frozenset({int, float, bool, type(None)})
"""The types of values of size 1."""
_local = threading.local()
_MOST_SHOWN: Final = 60


# Limits.


class WorkLimitError(ScenarioError):
    """An expression, or all expressions of a check or a run together, would need too much time or memory."""


class WorkBudget:
    """The work that the expressions of a check or a run may do together.

    `purpose` names the expressions in messages, such as `the expressions of this run`; `earned` returns additional work
    that is allowed by now; `spent` is the work so far.
    """

    def __init__(self, purpose: str, limit: int, earned: Callable[[], float] = lambda: 0.0) -> None:
        self.spent = 0
        self._purpose = purpose
        self._limit = limit
        self._earned = earned

    def is_spent(self) -> bool:
        """Return whether no work is left."""
        return self.spent > self._limit + self._earned()

    def message(self) -> str:
        """Return the text of the problem that the budget is used up."""
        return f"up to here, {self._purpose} need more work than {self._limit} items, characters and operations"

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Charge the budget with the expressions that the calling thread evaluates in a `with` block."""
        outer = getattr(_local, "budget", None)
        _local.budget = self
        try:
            yield
        finally:
            _local.budget = outer


def size_of(value: object) -> int:
    """Return the size of a value; a number over MAX_SIZE if it is larger, or nested too deep."""
    if type(value) in SCALARS:
        return 1
    size, level = 0, [value]
    for _ in range(MAX_LEVELS + 1):
        inner: list[Any] = []
        for item in level:
            size += 1
            if type(item) in SCALARS:
                continue
            if isinstance(item, str):
                size += len(item)
            elif isinstance(item, list | tuple | Mapping):
                if size + len(inner) + len(item) > MAX_SIZE:
                    return MAX_SIZE + 1
                inner += item.values() if isinstance(item, Mapping) else item
        if not inner:
            return size
        level = inner
    return MAX_SIZE + 1


def require_small(value: object, what: str) -> None:
    """Raise WorkLimitError if a value is too large."""
    if size_of(value) > MAX_SIZE:
        raise WorkLimitError(
            f"{what} has more than {MAX_SIZE} items and characters, or lists nested more than {MAX_LEVELS} levels deep"
        )


# Values.


@dataclass(frozen=True, slots=True)
class Namespace:
    """The variables of an expression, and the readings that it needs."""

    variables: Mapping[str, object]
    readings: Mapping[RobotReading, object] = field(default_factory=dict)


def evaluate(expression: Expression, names: Namespace) -> Any:
    """Return the value of an expression: a number, a text, a truth value, None or a list of them.

    A sole variable is returned unchanged.

    Raises:
        ScenarioError: a variable has no value, or the expression has none.
        WorkLimitError: it needs too much work.
    """
    if expression.flaws or expression.tree is None:
        raise ScenarioError(f"${{{expression.text}}}: {expression.flaws[0].message}")
    if isinstance(expression.tree, ast.Name) and expression.tree.id not in CONSTANTS:
        return _look_up(expression.tree.id, names)
    budget: WorkBudget | None = getattr(_local, "budget", None)
    if budget is not None and budget.is_spent():
        raise WorkLimitError(budget.message())
    if not hasattr(_local, "evaluator"):  # creating one takes longer than most expressions
        _local.evaluator = _Evaluator()
    evaluator: _Evaluator = _local.evaluator
    evaluator.names = _Names(names)
    evaluator.answers = names.readings
    evaluator.work = 0
    try:
        return evaluator.eval(expression.text, previously_parsed=expression.tree)
    except WorkLimitError as error:
        raise WorkLimitError(f"{textwrap.shorten(expression.text, _MOST_SHOWN)}: {error}") from error
    except ScenarioError:
        raise
    except (RefusalError, InvalidExpression) as error:
        raise ScenarioError(f"{expression.text.strip()}: {error}") from error
    except ZeroDivisionError as error:
        raise ScenarioError(f"{expression.text.strip()}: a division by zero") from error
    except Exception as error:  # an object of a Python step may raise any exception
        raise ScenarioError(f"{expression.text.strip()}: {_reason(error)}") from error
    finally:
        evaluator.names = {}
        evaluator.answers = {}
        if budget is not None:
            budget.spent += evaluator.work


def _reason(error: Exception) -> str:
    if isinstance(error, IndexError):
        return "the list or text has no such item"
    if isinstance(
        error, OverflowError
    ):  # its text is a pair of an error number and a reason, or tells of Python's types
        return "the result is too large"
    return str(error) or type(error).__name__


def to_plain(value: object, what: str) -> Any:
    """Return a value as expressions use it: numbers, texts and lists, without EALData and arrays.

    Raises ScenarioError if it is too large.
    """
    inner = value.value if isinstance(value, EALData) else value
    if hasattr(inner, "tolist"):
        if getattr(inner, "size", 0) > MAX_ITEMS:
            raise ScenarioError(f"{what} has more than {MAX_ITEMS} elements, too many for an expression")
        return inner.tolist()
    if isinstance(inner, tuple | list):
        require_small(inner, what)
    return _as_lists(inner)


def _as_lists(value: Any) -> Any:
    return [_as_lists(item) for item in value] if isinstance(value, tuple | list) else value


def _look_up(name: str, names: Namespace) -> object:
    try:
        return names.variables[name]
    except KeyError:
        raise ScenarioError(f"the variable '{name}' has no value: the step that gives it one did not succeed") from None


class _Names:
    """The variables and constants, as `simpleeval` looks them up."""

    def __init__(self, names: Namespace) -> None:
        self._namespace = names

    def __getitem__(self, name: str) -> Any:
        if name in CONSTANTS:
            return CONSTANTS[name]
        return to_plain(_look_up(name, self._namespace), f"the variable '{name}'")


class _Evaluator(SimpleEval):  # type: ignore[misc]  # simpleeval has no types
    """An evaluator with our operators, functions and lists, and nothing else."""

    answers: Mapping[RobotReading, object]
    work = 0

    def __init__(self) -> None:
        functions = {name: function.call for name, function in FUNCTIONS.items()}
        super().__init__(operators=dict(OPERATORS), functions=functions, names={})
        self.answers = {}
        for name, (method, _) in READINGS.items():
            self.functions[name] = self._reader(method)
        for kind in (ast.Assign, ast.AugAssign, ast.Import, ast.JoinedStr, ast.FormattedValue, ast.Expr):
            self.nodes.pop(kind, None)
        self.nodes[ast.List] = lambda node: [self._eval(item) for item in node.elts]

    def _check_disallowed_items(self, item: object) -> None:
        """Charge for the result of an operation. The grammar has no attributes and no calls of values to refuse."""
        self.work += 1 if type(item) in SCALARS else size_of(item)
        if self.work > MAX_SIZE:
            raise WorkLimitError(f"needs more work than {MAX_SIZE} items, characters and operations")

    def _reader(self, method: str) -> Any:
        def read(resource: str, argument: str | None = None) -> Any:
            reading = RobotReading(method, resource, argument)
            return to_plain(self.answers[reading], str(reading))

        return read


# Texts.


def render(value: object, names: Namespace) -> object:
    """Return a value with its expressions evaluated; a text that is one `${...}` becomes its value.

    Raises:
        ScenarioError: a variable has no value, or one that has no form in a text.
        WorkLimitError: the value is too large.
    """
    if isinstance(value, tuple):
        found = tuple(render(item, names) for item in value)
        if found != value:
            require_small(found, "the list")
        return found
    if not isinstance(value, str) or "${" not in value:
        return value
    template = parse_template(value)
    if template.whole is not None:
        return evaluate(template.whole, names)
    return render_text(value, names)


def render_text(text: str, names: Namespace) -> str:
    """Return a text with its expressions evaluated, as text even if it is one `${...}`; raise as `render` does."""
    if "${" not in text:
        return text
    template = parse_template(text)
    if template.flaws:
        raise ScenarioError(template.flaws[0].message)
    found = ""
    for part in template.parts:
        found += part if isinstance(part, str) else text_of(part[0], evaluate(part[0], names))
        require_small(found, "the text")
    return found


def text_of(expression: Expression, value: object) -> str:
    """Return the value of an expression in a text; raise ScenarioError if it has no form there, as a list."""
    found = to_plain(value, f"${{{expression.text}}}")
    if isinstance(found, str):
        return found
    if isinstance(found, bool | int | float):
        try:
            return as_text(found)
        except ValueError as error:  # Python writes no numbers of thousands of digits
            raise ScenarioError(f"${{{expression.text}}} is too long a number for a text") from error
    raise ScenarioError(f"${{{expression.text}}} is of type {type(found).__name__}, which has no form in a text")


def parse_bare(text: str) -> tuple[Expression, int]:
    """Parse a text that is an expression; return it with its offset. `${...}` around it is allowed."""
    template = parse_template(text) if text.startswith("${") else None
    if template is not None and template.whole is not None:
        return template.whole, 2
    return parse_expression(text), 0


def evaluate_bare(value: object, names: Namespace) -> Any:
    """Return the value of an expression without `${}`, or of a list of them; other values are returned as they are.

    Raises ScenarioError as `evaluate` does.
    """
    if isinstance(value, tuple | list):
        found = [evaluate_bare(item, names) for item in value]
        require_small(found, "the list")
        return found
    return evaluate(parse_bare(value)[0], names) if isinstance(value, str) else value


# Expressions in steps.


class LocatedExpression(NamedTuple):
    """An expression in a step. The keys lead from the step to the text that holds it."""

    expression: Expression
    keys: YamlPath
    text: str
    offset: int


def locate_expressions(keys: YamlPath, value: object, *, is_bare: bool = False) -> Iterator[LocatedExpression]:
    """Yield the expressions of a value at some keys of a step; a bare text is an expression without `${}`."""
    if isinstance(value, tuple | list):
        for index, item in enumerate(value):
            yield from locate_expressions((*keys, index), item, is_bare=is_bare)
    elif isinstance(value, str):
        if not is_bare and "${" not in value:
            return
        for expression, offset in (parse_bare(value),) if is_bare else parse_template(value).expressions():
            yield LocatedExpression(expression, keys, value, offset)


def expressions_in(value: object, *, is_bare: bool = False) -> list[Expression]:
    """Return the expressions of a value, or of the items of a list; see `locate_expressions`."""
    return [located.expression for located in locate_expressions((), value, is_bare=is_bare)]
