"""Texts with `${...}` in them; `$${` is a literal `${`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

from eal_actors.kernel.errors import ScenarioError
from eal_actors.scenario.expressions.evaluation import Known, evaluate, plain
from eal_actors.scenario.expressions.functions import as_text
from eal_actors.scenario.expressions.grammar import Expression, Flaw, parse_expression

_BROKEN: Final = "${ must go on as ${expression}; write $${ for a literal ${"


@dataclass(frozen=True, slots=True)
class Template:
    """A text, read.

    Attributes:
        parts: literal texts, and expressions with the offset of their first character in the text.
        flaws: what is wrong with it.
    """

    parts: tuple[str | tuple[Expression, int], ...]
    flaws: tuple[Flaw, ...] = ()

    @property
    def whole(self) -> Expression | None:
        """The expression, where the text is one `${...}` and nothing else."""
        return self.parts[0][0] if len(self.parts) == 1 and isinstance(self.parts[0], tuple) else None

    def expressions(self) -> Iterator[tuple[Expression, int]]:
        """Yield the expressions and where each begins in the text."""
        for part in self.parts:
            if isinstance(part, tuple):
                yield part


@lru_cache(maxsize=4096)
def parse_template(text: str) -> Template:
    """Read a text; what is wrong with it is told by its `flaws`."""
    parts: list[str | tuple[Expression, int]] = []
    flaws: list[Flaw] = []
    literal, position = "", 0
    while (start := text.find("${", position)) >= 0:
        if start > position and text[start - 1] == "$":
            literal += text[position : start - 1] + "${"
            position = start + 2
            continue
        literal += text[position:start]
        end = _closing(text, start + 2)
        if end is None:
            return Template((text,), (Flaw(_BROKEN, start),))
        if literal:
            parts.append(literal)
        literal, position = "", end + 1
        expression = parse_expression(text[start + 2 : end])
        parts.append((expression, start + 2))
        flaws += [Flaw(flaw.message, start + 2 + flaw.offset) for flaw in expression.flaws]
    literal += text[position:]
    if literal or not parts:
        parts.append(literal)
    return Template(tuple(parts), tuple(flaws))


def _closing(text: str, position: int) -> int | None:
    """Return where the brace stands that closes an expression; one within quotes does not."""
    quote = ""
    for index in range(position, len(text)):
        character = text[index]
        if quote:
            if character == quote and text[index - 1] != "\\":
                quote = ""
        elif character in "'\"":
            quote = character
        elif character == "}":
            return index
    return None


def expressions_in(value: object) -> Iterator[Expression]:
    """Yield the expressions in a value, item by item where it is a list."""
    if isinstance(value, tuple | list):
        for item in value:
            yield from expressions_in(item)
    elif isinstance(value, str) and "${" in value:
        for expression, _ in parse_template(value).expressions():
            yield expression


def render(value: object, known: Known) -> object:
    """Return a value with its expressions worked out; a text that is one `${...}` becomes what it stands for.

    Raises:
        ScenarioError: a variable has no value, or one that cannot stand inside a text.
    """
    if isinstance(value, tuple):
        return tuple(render(item, known) for item in value)
    if not isinstance(value, str) or "${" not in value:
        return value
    template = parse_template(value)
    if template.whole is not None:
        return evaluate(template.whole, known)
    return render_text(value, known)


def render_text(text: str, known: Known) -> str:
    """Return a text with its expressions worked out: the result is text even where it is one `${...}`.

    Raises:
        ScenarioError: see render.
    """
    if "${" not in text:
        return text
    template = parse_template(text)
    if template.flaws:
        raise ScenarioError(template.flaws[0].message)
    return "".join(
        part if isinstance(part, str) else _as_text(part[0], evaluate(part[0], known)) for part in template.parts
    )


def _as_text(expression: Expression, value: object) -> str:
    found = plain(value, f"${{{expression.text}}}")
    if isinstance(found, str):
        return found
    if isinstance(found, bool | int | float):
        try:
            return as_text(found)
        except ValueError as error:  # Python writes no numbers of thousands of digits
            raise ScenarioError(f"${{{expression.text}}} is too long a number to stand in a text") from error
    raise ScenarioError(f"${{{expression.text}}} is of type {type(found).__name__}, which cannot stand in a text")


def parse_bare(text: str) -> tuple[Expression, int]:
    """Read a text that is an expression by itself, and where that begins in it; `${...}` around it does no harm."""
    template = parse_template(text) if text.startswith("${") else None
    if template is not None and template.whole is not None:
        return template.whole, 2
    return parse_expression(text), 0


def evaluate_bare(value: object, known: Known) -> Any:
    """Return what an expression by itself stands for; a list is one of expressions, and other values are themselves.

    Raises:
        ScenarioError: see `evaluate`.
    """
    if isinstance(value, tuple | list):
        return [evaluate_bare(item, known) for item in value]
    return evaluate(parse_bare(value)[0], known) if isinstance(value, str) else value


def bare_expressions(value: object) -> list[Expression]:
    """Return the expressions in a value whose texts are expressions by themselves."""
    if isinstance(value, tuple | list):
        return [expression for item in value for expression in bare_expressions(item)]
    return [parse_bare(value)[0]] if isinstance(value, str) else []
