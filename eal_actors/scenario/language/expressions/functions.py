"""The functions and operators of expressions, bounded in time and memory."""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping
from decimal import Decimal
from typing import Any, Final, NamedTuple

MAX_BITS: Final = 256
"""Maximum length of a whole number in an expression."""
MAX_ITEMS: Final = 10_000
"""Maximum length of a list or text in an expression."""


class Function(NamedTuple):
    """A function, with its minimum and maximum number of arguments."""

    call: Callable[..., Any]
    least: int
    most: int

    def arity(self) -> str:
        """Return its number of arguments for people."""
        if self.least == self.most:
            return f"{self.least} argument{'' if self.least == 1 else 's'}"
        return f"at least {self.least}" if self.most >= MAX_ITEMS else f"{self.least} to {self.most} arguments"


class RefusalError(ValueError):
    """Why an expression has no value, for its author."""


def bounded(value: Any) -> Any:
    """Return a value; raise RefusalError if it is a number out of range, or too long."""
    if isinstance(value, int) and value.bit_length() > MAX_BITS:
        raise RefusalError(f"the result has more than {MAX_BITS} bits")
    if isinstance(value, float) and not math.isfinite(value):
        raise RefusalError("the result is not a finite number")
    if isinstance(value, str | list) and len(value) > MAX_ITEMS:
        raise RefusalError(f"the result has more than {MAX_ITEMS} items")
    return value


def _shown_type(value: object) -> str:
    names = {"str": "text", "int": "a number", "float": "a number", "bool": "a truth value", "NoneType": "nothing"}
    return names.get(type(value).__name__, f"a {type(value).__name__}")


def _numbers(name: str, *values: object) -> None:
    for value in values:
        if not isinstance(value, int | float):
            raise RefusalError(f"{name} takes numbers, not {_shown_type(value)}")


def _of_numbers(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
    def apply(*values: Any) -> Any:
        _numbers(name, *values)
        return bounded(work(*values))

    return apply


def _add(left: Any, right: Any) -> Any:
    if type(left) is type(right) and isinstance(left, str | list):
        if len(left) + len(right) > MAX_ITEMS:
            raise RefusalError(f"the result has more than {MAX_ITEMS} items")
        return left + right
    if isinstance(left, str | list) or isinstance(right, str | list):
        raise RefusalError(
            f"'+' takes two numbers, two texts or two lists, not {_shown_type(left)} and {_shown_type(right)}"
        )
    _numbers("'+'", left, right)
    return bounded(left + right)


def _power(base: Any, exponent: Any) -> Any:
    _numbers("'**'", base, exponent)
    if isinstance(base, int) and isinstance(exponent, int) and exponent * max(base.bit_length(), 1) > MAX_BITS:
        raise RefusalError(f"the result has more than {MAX_BITS} bits")
    result = base**exponent
    if isinstance(result, complex):
        raise RefusalError("the result is not a real number")
    return bounded(result)


def _ordered(symbol: str, work: Callable[[Any, Any], bool]) -> Callable[[Any, Any], bool]:
    def apply(left: Any, right: Any) -> bool:
        if not (isinstance(left, str) and isinstance(right, str)):
            _numbers(symbol, left, right)
        return work(left, right)

    return apply


def _within(item: Any, container: Any) -> bool:
    if isinstance(container, str) and not isinstance(item, str):
        raise RefusalError(f"'in' looks for text in a text, not for {_shown_type(item)}")
    if not isinstance(container, str | list):
        raise RefusalError(f"'in' looks into a list or a text, not into {_shown_type(container)}")
    return item in container


OPERATORS: Final[Mapping[type[ast.AST], Callable[..., Any]]] = {
    ast.Add: _add,
    ast.Sub: _of_numbers("'-'", operator.sub),
    ast.Mult: _of_numbers("'*'", operator.mul),
    ast.Div: _of_numbers("'/'", operator.truediv),
    ast.FloorDiv: _of_numbers("'//'", operator.floordiv),
    ast.Mod: _of_numbers("'%'", operator.mod),
    ast.Pow: _power,
    ast.USub: _of_numbers("'-'", operator.neg),
    ast.UAdd: _of_numbers("'+'", operator.pos),
    ast.Not: operator.not_,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: _ordered("'<'", operator.lt),
    ast.LtE: _ordered("'<='", operator.le),
    ast.Gt: _ordered("'>'", operator.gt),
    ast.GtE: _ordered("'>='", operator.ge),
    ast.In: _within,
    ast.NotIn: lambda item, container: not _within(item, container),
}


def _items(name: str, value: object) -> list[Any]:
    if not isinstance(value, list):
        raise RefusalError(f"{name}() takes a list, not {_shown_type(value)}")
    return value


def _range(*bounds: Any) -> list[int]:
    for bound in bounds:
        if not isinstance(bound, int) or isinstance(bound, bool):
            raise RefusalError(f"range() takes whole numbers, not {bound!r}")
    numbers = range(*bounds)
    if max(map(abs, bounds)) > 2**60 or len(numbers) > MAX_ITEMS:
        raise RefusalError(f"range() gives at most {MAX_ITEMS} items")
    return list(numbers)


def _repeated(values: Any, times: Any) -> list[Any]:
    items = _items("repeated", values)
    if not isinstance(times, int) or isinstance(times, bool) or times < 0:
        raise RefusalError(f"repeated() takes a whole number of times from 0, not {times!r}")
    if len(items) * times > MAX_ITEMS:
        raise RefusalError(f"repeated() gives at most {MAX_ITEMS} items")
    return items * times


def _length(value: Any) -> int:
    if not isinstance(value, str | list):
        raise RefusalError(f"len() takes a list or a text, not {_shown_type(value)}")
    return len(value)


def _number(kind: type[int] | type[float]) -> Callable[[Any], Any]:
    def apply(value: Any) -> Any:
        if not isinstance(value, int | float | str):
            raise RefusalError(f"{kind.__name__}() takes a number or a text, not {_shown_type(value)}")
        try:
            number = kind(value)
        except (ValueError, OverflowError) as error:
            raise RefusalError(f"{value!r} is no {'whole ' if kind is int else ''}number") from error
        return bounded(number)

    return apply


def _best(name: str, choose: Callable[..., Any]) -> Callable[..., Any]:
    def apply(*values: Any) -> Any:
        items = _items(name, values[0]) if len(values) == 1 else list(values)
        if not items:
            raise RefusalError(f"{name}() of an empty list has no value")
        if not all(isinstance(item, str) for item in items):
            _numbers(f"{name}()", *items)
        return choose(items)

    return apply


def _round(value: Any, digits: Any = None) -> Any:
    _numbers("round()", value)
    if digits is not None and (not isinstance(digits, int) or not -20 <= digits <= 20):
        raise RefusalError(f"round() takes a number of digits from -20 to 20, not {digits!r}")
    return bounded(round(value, digits))


def _sum(values: Any) -> Any:
    items = _items("sum", values)
    _numbers("sum()", *items)
    return bounded(sum(items))


def _wrap_deg(angle_deg: float) -> float:
    """Return the same direction as an angle over -180 and up to 180."""
    wrapped = math.remainder(angle_deg, 360)
    return 180.0 if wrapped == -180 else wrapped


def _text(value: Any) -> str:
    if not isinstance(value, str | int | float):
        raise RefusalError(f"str() takes a number, a truth value or a text, not {_shown_type(value)}")
    return value if isinstance(value, str) else as_text(value)


def as_text(value: bool | int | float) -> str:
    """Return a number or truth value as a command text: `45` for 45.0, never in powers of ten.

    Fifteen digits are correct for every float; the digits after them are rounding errors of arithmetic, as in
    0.1 + 0.7 = 0.7999999999999999.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if not isinstance(value, float) or not math.isfinite(value):
        return str(value)
    rounded = Decimal(f"{value:z.14e}")  # without the sign of -0.0
    text = f"{rounded:f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


FUNCTIONS: Final[Mapping[str, Function]] = {
    "abs": Function(_of_numbers("abs()", abs), 1, 1),
    "atan2": Function(_of_numbers("atan2()", math.atan2), 2, 2),
    "bool": Function(bool, 1, 1),
    "ceil": Function(_of_numbers("ceil()", math.ceil), 1, 1),
    "cos": Function(_of_numbers("cos()", math.cos), 1, 1),
    "degrees": Function(_of_numbers("degrees()", math.degrees), 1, 1),
    "float": Function(_number(float), 1, 1),
    "floor": Function(_of_numbers("floor()", math.floor), 1, 1),
    "hypot": Function(_of_numbers("hypot()", math.hypot), 2, 3),
    "int": Function(_number(int), 1, 1),
    "len": Function(_length, 1, 1),
    "max": Function(_best("max", max), 1, MAX_ITEMS),
    "min": Function(_best("min", min), 1, MAX_ITEMS),
    "radians": Function(_of_numbers("radians()", math.radians), 1, 1),
    "range": Function(_range, 1, 3),
    "repeated": Function(_repeated, 2, 2),
    "round": Function(_round, 1, 2),
    "sin": Function(_of_numbers("sin()", math.sin), 1, 1),
    "sqrt": Function(_of_numbers("sqrt()", math.sqrt), 1, 1),
    "str": Function(_text, 1, 1),
    "sum": Function(_sum, 1, 1),
    "tan": Function(_of_numbers("tan()", math.tan), 1, 1),
    "wrap_deg": Function(_of_numbers("wrap_deg()", _wrap_deg), 1, 1),
}

CONSTANTS: Final[Mapping[str, object]] = {
    "pi": math.pi,
    "true": True,
    "false": False,
}
