"""Works out expressions, by `simpleeval` and never by `eval`."""

from __future__ import annotations

import ast
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simpleeval import InvalidExpression, SimpleEval

from eal_actors.device.data import EALData
from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.expressions.functions import CONSTANTS, FUNCTIONS, MAX_ITEMS, OPERATORS, RefusalError
from eal_actors.scenario.expressions.grammar import READINGS, Expression, Reading


@dataclass(frozen=True, slots=True)
class Known:
    """What has a value where an expression stands.

    Attributes:
        variables: by name; `run` is a mapping.
        readings: what the robot has answered.
    """

    variables: Mapping[str, object]
    readings: Mapping[Reading, object] = field(default_factory=dict)


def evaluate(expression: Expression, known: Known) -> Any:
    """Return the value of an expression: a number, a text, a truth value, None or a list of them.

    A variable that stands alone is returned as it is.

    Raises:
        ScenarioError: a variable has no value, or what is to be worked out cannot be.
    """
    if expression.flaws or expression.tree is None:
        raise ScenarioError(f"${{{expression.text}}}: {expression.flaws[0].message}")
    if isinstance(expression.tree, ast.Name) and expression.tree.id not in CONSTANTS:
        return _look_up(expression.tree.id, known)
    evaluator = _evaluator()
    evaluator.names = _Names(known)
    evaluator.answers = known.readings
    try:
        return evaluator.eval(expression.text, previously_parsed=expression.tree)
    except ScenarioError:
        raise
    except (RefusalError, InvalidExpression) as error:
        raise ScenarioError(f"{expression.text.strip()}: {error}") from error
    except ZeroDivisionError as error:
        raise ScenarioError(f"{expression.text.strip()}: a division by zero") from error
    except Exception as error:  # a function's own object may raise whatever it likes
        raise ScenarioError(f"{expression.text.strip()}: {_reason(error)}") from error
    finally:
        evaluator.names = {}
        evaluator.answers = {}


def _reason(error: Exception) -> str:
    if isinstance(error, IndexError):
        return "the list or text has no such item"
    return str(error) or type(error).__name__


def plain(value: object, what: str) -> Any:
    """Return a value as expressions work with it: what a number, text or list of them stands for.

    Raises:
        ScenarioError: it is too large.
    """
    inner = value.value if isinstance(value, EALData) else value
    if hasattr(inner, "tolist"):
        if getattr(inner, "size", 0) > MAX_ITEMS:
            raise ScenarioError(f"{what} has more than {MAX_ITEMS} elements, too many for an expression")
        return inner.tolist()
    return _as_lists(inner)


def _as_lists(value: Any) -> Any:
    return [_as_lists(item) for item in value] if isinstance(value, tuple | list) else value


def _look_up(name: str, known: Known) -> object:
    try:
        return known.variables[name]
    except KeyError:
        raise ScenarioError(f"the variable '{name}' has no value: the step that gives it one did not succeed") from None


class _Names:
    """The variables and constants, as `simpleeval` asks for them."""

    def __init__(self, known: Known) -> None:
        self._known = known

    def __getitem__(self, name: str) -> Any:
        if name in CONSTANTS:
            return CONSTANTS[name]
        return plain(_look_up(name, self._known), f"the variable '{name}'")


class _Evaluator(SimpleEval):  # type: ignore[misc]  # simpleeval has no types
    """Knows our operators, functions and lists, and nothing else."""

    answers: Mapping[Reading, object]

    def __init__(self) -> None:
        functions = {name: function.call for name, function in FUNCTIONS.items()}
        super().__init__(operators=dict(OPERATORS), functions=functions, names={})
        self.answers = {}
        for name, (method, _) in READINGS.items():
            self.functions[name] = self._reader(method)
        for kind in (ast.Assign, ast.AugAssign, ast.Import, ast.JoinedStr, ast.FormattedValue, ast.Expr):
            self.nodes.pop(kind, None)
        self.nodes[ast.List] = lambda node: [self._eval(item) for item in node.elts]

    def _reader(self, method: str) -> Any:
        def read(resource: str, argument: str | None = None) -> Any:
            reading = Reading(method, resource, argument)
            return plain(self.answers[reading], str(reading))

        return read


_local = threading.local()


def _evaluator() -> _Evaluator:
    """Return the thread's own evaluator: making one takes longer than most expressions."""
    if not hasattr(_local, "evaluator"):
        _local.evaluator = _Evaluator()
    evaluator: _Evaluator = _local.evaluator
    return evaluator
