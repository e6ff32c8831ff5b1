"""Holds the unit of a parameter against that of what takes its value: text and number alike say nothing of it."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from typing import Any, Final

from eal_actors.device.data import EALData, ValueInfo
from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.expressions import parse_template
from eal_actors.scenario.model import AnyStep, CallStep, ScenarioFile, ScenarioStep, call_fields

_SECONDS: Final = "s"
_TIMES: Final = ("timeout_s", "wait_s")


def unit_problems(
    step: AnyStep, file: ScenarioFile, part: ScenarioFile | None = None
) -> Iterator[tuple[YamlPath, str]]:
    """Yield where times and the parameters of a part are given in the wrong unit, and why it is wrong.

    Args:
        step: the step.
        file: the scenario that it belongs to.
        part: the scenario that it carries out, if it does.
    """
    for key in _TIMES:
        if (wrong := _mismatch(getattr(step, key, None), file, _SECONDS, "this")) is not None:
            yield (key,), wrong
    if isinstance(step, ScenarioStep) and part is not None:
        for name, value in step.with_.items():
            taker = part.parameters.get(name)
            wrong = _mismatch(value, file, taker.unit if taker is not None else None, f"parameter '{name}'")
            if wrong is not None:
                yield ("with", name), wrong


def call_unit_problem(
    step: CallStep, file: ScenarioFile, info: ResourceInfo, given: Mapping[str, Any]
) -> tuple[YamlPath, str] | None:
    """Return where a call is given its argument in the wrong unit, and why it is wrong; None if nothing is.

    Args:
        step: the call.
        file: the scenario that it belongs to.
        info: the resource that takes it.
        given: what it is given, worked out and found to fit.
    """
    for name in ("value", "data", "cmd"):
        value = call_fields(step).get(name)
        if _unit_of(value, file) is not None:
            taker = _taker(step.kind, info, given)
            what = f"{info.name} {given.get('cmd') or given.get('key') or step.kind}"
            wrong = _mismatch(value, file, taker.unit if taker is not None else None, what)
            return ((step.kind, name), wrong) if wrong is not None else None
    return None


def _unit_of(value: object, file: ScenarioFile) -> str | None:
    """Return the unit of the parameter that a value is; None if it is none, or has no unit."""
    name = _sole_name(value)
    section = file.parameters.get(name) if name is not None else None
    return section.unit if section is not None else None


def _taker(method: str, info: ResourceInfo, given: Mapping[str, Any]) -> ValueInfo | None:
    if method == "set_value":
        return info.value
    if method == "set_config" and info.configs:
        return info.config(str(given["key"])).value
    if method == "send_cmd" and info.commands:
        data = EALData.of(given["data"]) if "data" in given else None
        return info.parse_command(str(given["cmd"]), data)[0].argument
    return None


def _mismatch(value: object, file: ScenarioFile, wanted: str | None, what: str) -> str | None:
    """Return why a value must not be given where a unit is wanted: only of a parameter by itself is the unit known."""
    unit = _unit_of(value, file)
    if unit is None or not wanted or unit == wanted:
        return None
    return f"parameter '{_sole_name(value)}' is in {unit}, and {what} takes {wanted}"


def _sole_name(value: object) -> str | None:
    """Return the variable that a text is, but for what stands before it, as in `f${distance_m}`."""
    if not isinstance(value, str) or "${" not in value:
        return None
    expressions = [expression for expression, _ in parse_template(value).expressions()]
    tree = expressions[0].tree if len(expressions) == 1 else None
    return tree.id if isinstance(tree, ast.Name) else None
