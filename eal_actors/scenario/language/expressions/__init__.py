"""Expressions in `${...}`: parsed and checked when the file is read, evaluated when the step is reached."""

from eal_actors.scenario.language.expressions.budget import MAX_WORK, WorkBudget, WorkLimitError, size_of
from eal_actors.scenario.language.expressions.evaluation import (
    LocatedExpression,
    Namespace,
    Template,
    bare_expressions,
    evaluate,
    evaluate_bare,
    expressions_in,
    locate_expressions,
    parse_bare,
    parse_template,
    render,
    render_text,
    to_plain,
)
from eal_actors.scenario.language.expressions.grammar import (
    Expression,
    Flaw,
    Name,
    RobotReading,
    parse_expression,
)

__all__ = [
    "MAX_WORK",
    "Expression",
    "Flaw",
    "LocatedExpression",
    "Name",
    "Namespace",
    "RobotReading",
    "Template",
    "WorkBudget",
    "WorkLimitError",
    "bare_expressions",
    "evaluate",
    "evaluate_bare",
    "expressions_in",
    "locate_expressions",
    "parse_bare",
    "parse_expression",
    "parse_template",
    "render",
    "render_text",
    "size_of",
    "to_plain",
]
