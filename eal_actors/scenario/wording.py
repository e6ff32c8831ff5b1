"""Steps in words, and the expressions in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

from eal_actors.kernel.errors import EALError
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.expressions import Expression, Known, expressions_in, parse_bare, parse_template, render
from eal_actors.scenario.model import (
    AnswerStep,
    AnyStep,
    BarrierStep,
    BlockStep,
    CallStep,
    ExpectStep,
    ForStep,
    IfStep,
    LetStep,
    LogStep,
    OnStep,
    ParallelStep,
    PythonStep,
    RepeatStep,
    ScenarioStep,
    SignalStep,
    TimedStep,
    WaitForStep,
    WaitingStep,
    WaitStep,
    WaitUntilStep,
    WhileStep,
    call_fields,
)

_MOST_VALUES = 8


class Placed(NamedTuple):
    """An expression in a step.

    Attributes:
        expression: the expression.
        keys: the keys from the step to the text that holds it.
        text: that text.
        offset: where in the text it begins.
    """

    expression: Expression
    keys: YamlPath
    text: str
    offset: int


def step_expressions(step: AnyStep) -> Iterator[Placed]:
    """Yield the expressions of a step itself, without those of the steps inside it."""
    for keys, value in _values(step):
        yield from _placed(keys, value, _in_braces)
    for keys, value in _bare_values(step):
        yield from _placed(keys, value, lambda text: [parse_bare(text)])


def _in_braces(text: str) -> Iterable[tuple[Expression, int]]:
    return parse_template(text).expressions() if "${" in text else ()


def _placed(keys: YamlPath, value: object, read: Callable[[str], Iterable[tuple[Expression, int]]]) -> Iterator[Placed]:
    if isinstance(value, tuple | list):
        for index, item in enumerate(value):
            yield from _placed((*keys, index), item, read)
    elif isinstance(value, str):
        for expression, offset in read(value):
            yield Placed(expression, keys, value, offset)


def _values(step: AnyStep) -> list[tuple[YamlPath, object]]:
    """Return the values of a step with `${...}` in them, and the keys that lead to them."""
    found: list[tuple[YamlPath, object]] = []
    if isinstance(step, BlockStep | TimedStep | WaitingStep):
        found.append((("timeout_s",), step.timeout_s))
    match step:
        case CallStep():
            fields = {"resource": step.arguments.resource, **call_fields(step)}
            found += [((step.kind, name), value) for name, value in fields.items()]
            if isinstance(step, AnswerStep):
                found.append((("save",), step.save))
        case WaitStep():
            found.append((("wait_s",), step.wait_s))
        case WaitForStep():
            found += [(("count",), step.count), (("default",), step.default)]
        case SignalStep():
            found.append((("value",), step.value))
        case ExpectStep():
            found += [(("equals",), step.equals), (("says",), step.says)]
        case LogStep():
            found.append((("log",), step.log))
        case ForStep():
            found.append((("for", step.variable), step.values))
        case RepeatStep():
            found.append((("repeat",), step.repeat))
        case WhileStep():
            found.append((("limit",), step.limit))
        case PythonStep() | ScenarioStep():
            found += [(("with", name), value) for name, value in step.with_.items()]
    return found


def _bare_values(step: AnyStep) -> list[tuple[YamlPath, object]]:
    """Return the values of a step that are expressions by themselves, and the keys that lead to them."""
    match step:
        case WaitUntilStep():
            return [(("wait_until",), step.wait_until)]
        case LetStep():
            return [(("let", name), value) for name, value in step.let.items()]
        case ExpectStep():
            return [(("expect",), step.expect)]
        case WhileStep():
            return [(("while",), step.while_)]
        case IfStep():
            return [(("if",), step.if_)]
    return []


def describe_step(step: AnyStep, parameters: Mapping[str, object]) -> str:
    """Return what a step does, with the values of parameters put in; the steps inside it are left out."""

    def shown(value: object) -> str:
        return _shown(value, parameters)

    if isinstance(step, BlockStep):
        limit = f", within {shown(step.timeout_s)} s" if step.timeout_s is not None else ""
        return _block(step, shown) + limit
    match step:
        case CallStep():
            fields = call_fields(step)
            words = [step.kind, shown(step.arguments.resource), *(shown(v) for v in fields.values() if v is not None)]
            if isinstance(step, AnswerStep) and step.save is not None:
                words.append(f"-> {shown(step.save)}")
            if isinstance(step, AnswerStep) and step.save_as is not None:
                words.append(f"-> {step.save_as}")
            return " ".join(words) + (", together" if step.is_together else "")
        case PythonStep():
            return f"python {step.python}({_given(step.with_, shown)})" + (
                f" -> {step.save_as}" if step.save_as else ""
            )
        case LetStep():
            return "let " + ", ".join(f"{name} = {shown(value)}" for name, value in step.let.items())
    return _leaf(step, parameters)


def _block(step: BlockStep, shown: Callable[[object], str]) -> str:
    match step:
        case OnStep():
            return f"on {step.on}" + _until(step.until)
        case ParallelStep():
            return "parallel" + _until(step.until)
        case ForStep():
            return f"for {step.variable} in {shown(step.values)}"
        case RepeatStep():
            return f"repeat {shown(step.repeat)} times"
        case WhileStep():
            return f"while {step.while_}, at most {shown(step.limit)} times"
        case IfStep():
            return f"if {step.if_}"
        case ScenarioStep():
            return f"scenario {step.scenario}" + (f" with {_given(step.with_, shown)}" if step.with_ else "")
    return step.kind


def _given(values: Mapping[str, object], shown: Callable[[object], str]) -> str:
    return ", ".join(f"{name}={shown(value)}" for name, value in values.items())


def _leaf(step: AnyStep, parameters: Mapping[str, object]) -> str:
    match step:
        case WaitStep():
            return f"wait {_shown(step.wait_s, parameters)} s"
        case WaitUntilStep():
            return f"wait until {step.wait_until}, at most {_shown(step.timeout_s, parameters)} s"
        case BarrierStep():
            return f"meet at barrier {step.barrier}, within {_shown(step.timeout_s, parameters)} s"
        case SignalStep():
            return f"give signal {step.signal}"
        case WaitForStep():
            times = f" {_shown(step.count, parameters)} times" if step.count != 1 else ""
            default = f", else {_shown(step.default, parameters)}" if step.default is not None else ""
            return f"wait for signal {step.wait_for}{times}, at most {_shown(step.timeout_s, parameters)} s{default}"
        case ExpectStep():
            tolerance = f" ± {step.tolerance:g}" if step.tolerance else ""
            equals = f" to be {_shown(step.equals, parameters)}{tolerance}" if step.equals is not None else ""
            return f"expect {step.expect}{equals}"
        case LogStep():
            return f"log {_shown(step.log, parameters)}"
    return step.kind


def _until(until: str) -> str:
    return {"all": "", "first": ", until the first is through"}.get(until, f", until signal {until}")


def _shown(value: object, parameters: Mapping[str, object]) -> str:
    """Return a value as it will be, as far as parameters tell; else as it is written."""
    if isinstance(value, tuple | list):
        items = [_shown(item, parameters) for item in value[:_MOST_VALUES]]
        return f"[{', '.join(items)}{', ...' if len(value) > _MOST_VALUES else ''}]"
    if not isinstance(value, str) or "${" not in value:
        return f"{value:g}" if isinstance(value, float) else str(value)
    needed = {name.name for expression, _ in parse_template(value).expressions() for name in expression.names}
    if not needed <= set(parameters) or any(expression.readings for expression in expressions_in(value)):
        return value
    try:
        return _shown(render(value, Known(parameters)), {})
    except EALError:
        return value
