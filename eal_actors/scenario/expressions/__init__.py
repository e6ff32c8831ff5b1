"""`${...}` in a scenario's texts: what stands in it, checked when the file is read and worked out when it is needed."""

from eal_actors.scenario.expressions.evaluation import Known, evaluate
from eal_actors.scenario.expressions.grammar import Expression, Flaw, Name, Reading, parse_expression
from eal_actors.scenario.expressions.template import (
    Template,
    bare_expressions,
    evaluate_bare,
    expressions_in,
    parse_bare,
    parse_template,
    render,
    render_text,
)

__all__ = [
    "Expression",
    "Flaw",
    "Known",
    "Name",
    "Reading",
    "Template",
    "bare_expressions",
    "evaluate",
    "evaluate_bare",
    "expressions_in",
    "parse_bare",
    "parse_expression",
    "parse_template",
    "render",
    "render_text",
]
