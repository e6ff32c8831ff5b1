"""The grammar of expressions, and the parser that checks them before any is evaluated.

    ${speed_m_s * 2}    ${'left' if index % 2 == 0 else 'right'}    ${value('Range') < 0.5 and not found}

Numbers, texts, lists, arithmetic, comparison, `and`, `or`, `not`, a choice by `if ... else`, items by `[...]`, the
functions of `functions.FUNCTIONS`, and four that read from the robot, with names written out. Attributes,
comprehensions, lambdas and everything else of Python are not part of it.
"""

from __future__ import annotations

import ast
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, NamedTuple

from eal_actors.device.info import unknown_name
from eal_actors.scenario.language.expressions.functions import CONSTANTS, FUNCTIONS, OPERATORS, RefusalError, bounded

MAX_LENGTH: Final = 1000
"""Characters of one expression."""
_MAX_DEPTH: Final = 40
RUN_FACTS: Final = ("seed",)
"""The attributes of `run`, the only name that has any."""

READINGS: Final = {
    "value": ("get_value", 1),
    "status": ("get_status", 1),
    "config": ("get_config", 2),
    "request": ("send_req", 2),
}
"""The functions that call the robot: their methods, and their numbers of arguments."""

_STRUCTURE: Final = (
    ast.Name,
    ast.Constant,
    ast.BinOp,
    ast.UnaryOp,
    ast.BoolOp,
    ast.And,
    ast.Or,
    ast.Compare,
    ast.IfExp,
    ast.Call,
    ast.Subscript,
    ast.Slice,
    ast.List,
    ast.Load,
    *OPERATORS,
)


class Flaw(NamedTuple):
    """A problem of an expression, and its offset in characters."""

    message: str
    offset: int


class Name(NamedTuple):
    """A variable of an expression, and its offset in characters."""

    name: str
    offset: int


class RobotReading(NamedTuple):
    """A call of the robot in an expression: a method of the resource API, with the key or request as its argument."""

    method: str
    resource: str
    argument: str | None = None

    def __str__(self) -> str:
        """Return it as it is written in the file."""
        name = next(name for name, (method, _) in READINGS.items() if method == self.method)
        more = f", {self.argument!r}" if self.argument is not None else ""
        return f"{name}({self.resource!r}{more})"


@dataclass(frozen=True, slots=True)
class Expression:
    """A parsed expression: names at their first position, and calls of the robot with their offsets.

    The tree is None if it does not parse. An expression with flaws has no value.
    """

    text: str
    tree: ast.expr | None
    names: tuple[Name, ...] = ()
    readings: tuple[tuple[RobotReading, int], ...] = ()
    flaws: tuple[Flaw, ...] = ()

    @property
    def is_constant(self) -> bool:
        """Whether its value depends on nothing."""
        return not self.names and not self.readings and not re.search(r"\brun\b", self.text)


@lru_cache(maxsize=4096)
def parse_expression(text: str) -> Expression:
    """Parse an expression; its problems are its `flaws`."""
    stripped = text.strip()
    if not stripped:
        return Expression(text, None, flaws=(Flaw("an expression is missing", 0),))
    if len(text) > MAX_LENGTH:
        return Expression(text, None, flaws=(Flaw(f"is longer than {MAX_LENGTH} characters", 0),))
    if "\n" in stripped:
        return Expression(text, None, flaws=(Flaw("must be on one line", text.index("\n")),))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of doubtful code, such as `1()`, which is refused anyway
            tree = ast.parse(stripped, mode="eval").body
    except SyntaxError as error:
        offset = max((error.offset or 1) - 1, 0)
        return Expression(text, None, flaws=(Flaw(_syntax_message(stripped, error), _lead(text) + offset),))
    except (RecursionError, MemoryError, ValueError):
        return Expression(text, None, flaws=(Flaw("is nested too deep, or contains invalid characters", 0),))
    reader = _TreeReader(stripped, _lead(text))
    reader.visit(tree, 0)
    names = tuple(Name(name, offset) for name, offset in reader.names.items())
    return Expression(
        text, tree, names, tuple(reader.readings.items()), tuple(sorted(reader.flaws, key=lambda f: f.offset))
    )


def _lead(text: str) -> int:
    return len(text) - len(text.lstrip())


def _syntax_message(text: str, error: SyntaxError) -> str:
    reason = (error.msg or "invalid syntax").split(". Maybe you meant")[0]
    hint = "; write == to compare" if "=" in text and "cannot assign" in reason else ""
    return f"{text!r} is not an expression: {reason}{hint}"


def _symbols(node: ast.AST) -> list[ast.AST]:
    """Return the operators of a node, without those of its children."""
    if isinstance(node, ast.BinOp | ast.UnaryOp):
        return [node.op]
    return list(node.ops) if isinstance(node, ast.Compare) else []


class _TreeReader:
    """Collects the variables, readings and flaws of an expression's tree."""

    def __init__(self, text: str, lead: int) -> None:
        self.names: dict[str, int] = {}
        self.readings: dict[RobotReading, int] = {}
        self.flaws: list[Flaw] = []
        self._text = text
        self._lead = lead

    def _offset(self, node: ast.AST) -> int:
        column = getattr(node, "col_offset", 0)  # in bytes of UTF-8
        return self._lead + len(self._text.encode()[:column].decode(errors="replace"))

    def _flaw(self, node: ast.AST, message: str) -> None:
        self.flaws.append(Flaw(message, self._offset(node)))

    def visit(self, node: ast.AST, depth: int) -> None:
        if depth > _MAX_DEPTH:
            self._flaw(node, f"is nested more than {_MAX_DEPTH} levels deep")
        elif isinstance(node, ast.Call):
            self._call(node, depth)
        elif isinstance(node, ast.Name):
            if node.id in FUNCTIONS or node.id in READINGS:
                self._flaw(node, f"'{node.id}' is a function; write {node.id}(...)")
            elif node.id not in CONSTANTS:
                self.names.setdefault(node.id, self._offset(node))
        elif isinstance(node, ast.Attribute):
            self._attribute(node)
        elif isinstance(node, ast.Constant):
            self._constant(node)
        elif isinstance(node, _STRUCTURE) and all(type(symbol) in OPERATORS for symbol in _symbols(node)):
            for child in ast.iter_child_nodes(node):
                self.visit(child, depth + 1)
        else:
            self._flaw(node, f"{self._source(node)} is not part of the expression language")

    def _constant(self, node: ast.Constant) -> None:
        if not isinstance(node.value, str | int | float | bool | None):
            self._flaw(node, f"{node.value!r} is neither a number nor text nor true or false")
            return
        try:
            bounded(node.value)
        except RefusalError as error:
            self._flaw(node, str(error))

    def _source(self, node: ast.AST) -> str:
        return repr(ast.get_source_segment(self._text, node) or type(node).__name__)

    def _attribute(self, node: ast.Attribute) -> None:
        if isinstance(node.value, ast.Name) and node.value.id == "run":
            if node.attr not in RUN_FACTS:
                self._flaw(node, unknown_name("fact of the run", node.attr, RUN_FACTS))
            return
        self._flaw(node, f"'.{node.attr}' is not part of the expression language; items are written with [...]")

    def _call(self, node: ast.Call, depth: int) -> None:
        if not isinstance(node.func, ast.Name):
            self._flaw(node, f"{self._source(node.func)} cannot be called")
            return
        name = node.func.id
        if name in READINGS:
            self._reading(node, name)
            return
        function = FUNCTIONS.get(name)
        if function is None:
            self._flaw(node, unknown_name("function", name, [*FUNCTIONS, *READINGS]))
        elif node.keywords:
            self._flaw(node, f"{name}() takes its arguments without names")
        elif not function.least <= len(node.args) <= function.most:
            self._flaw(node, f"{name}() takes {function.arity()}, not {len(node.args)}")
        for argument in node.args:
            self.visit(argument, depth + 1)

    def _reading(self, node: ast.Call, name: str) -> None:
        method, count = READINGS[name]
        texts = [arg.value for arg in node.args if isinstance(arg, ast.Constant) and isinstance(arg.value, str)]
        if len(texts) != len(node.args) or node.keywords:
            self._flaw(
                node,
                f"{name}() takes names in quotes, such as {name}({_EXAMPLES[name]}); they are checked before the run",
            )
        elif len(texts) != count:
            self._flaw(node, f"{name}() takes {count} text{'s' * (count > 1)}, such as {name}({_EXAMPLES[name]})")
        else:
            self.readings.setdefault(RobotReading(method, *texts), self._offset(node))


_EXAMPLES: Final = {
    "value": "'Range'",
    "status": "'Base'",
    "config": "'Base', 'step_m'",
    "request": "'Base', 'position'",
}


# Texts with expressions.

_UP_TO_BRACE: Final = re.compile(r"""((?:[^'"}]+|'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*")*+)\}""", re.DOTALL)
"""An expression and the brace that closes it; braces in quotes do not count."""
_BROKEN: Final = "${ must be closed, as in ${expression}; write $${ for a literal ${"


@dataclass(frozen=True, slots=True)
class Template:
    """A parsed text. `parts` are literal texts, and expressions with the offset of their first character in it."""

    parts: tuple[str | tuple[Expression, int], ...]
    flaws: tuple[Flaw, ...] = ()

    @property
    def whole(self) -> Expression | None:
        """The expression, if the text is one `${...}` and nothing else."""
        return self.parts[0][0] if len(self.parts) == 1 and isinstance(self.parts[0], tuple) else None

    def expressions(self) -> Iterator[tuple[Expression, int]]:
        """Yield the expressions with their offsets in the text."""
        for part in self.parts:
            if isinstance(part, tuple):
                yield part


@lru_cache(maxsize=4096)
def parse_template(text: str) -> Template:
    """Parse a text; its problems are its `flaws`."""
    parts: list[str | tuple[Expression, int]] = []
    flaws: list[Flaw] = []
    literal, position = "", 0
    while (start := text.find("${", position)) >= 0:
        if start > position and text[start - 1] == "$":
            literal += text[position : start - 1] + "${"
            position = start + 2
            continue
        literal += text[position:start]
        match = _UP_TO_BRACE.match(text, start + 2)
        if match is None:
            return Template((text,), (Flaw(_BROKEN, start),))
        if literal:
            parts.append(literal)
        literal, position = "", match.end()
        expression = parse_expression(match[1])
        parts.append((expression, start + 2))
        flaws += [Flaw(flaw.message, start + 2 + flaw.offset) for flaw in expression.flaws]
    literal += text[position:]
    if literal or not parts:
        parts.append(literal)
    return Template(tuple(parts), tuple(flaws))
