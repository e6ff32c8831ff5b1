"""The parameters of a scenario: their declarations, their values, and their units."""

from __future__ import annotations

import ast
import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

from eal_actors.device.data.texts import range_text
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.kernel.yaml_tree import YamlTree, show
from eal_actors.scenario.language.expressions.grammar import parse_template
from eal_actors.scenario.language.scenario import Scenario, ScenarioFile
from eal_actors.scenario.language.sections import ParameterSection

_TRUTHS: Final = {"true": True, "false": False}
_EXAMPLES: Final = {"int": "3", "double": "0.5", "bool": "true", "string": "TEXT", "list": "[1,2]"}


# Declarations.


def check_parameters(file: ScenarioFile, tree: YamlTree) -> list[Problem]:
    """Return the problems of the declarations, defaults included."""
    problems = []
    for name, section in file.parameters.items():
        path = ("parameters", name)
        numeric = section.type in ("int", "double")
        problems += [
            tree.problem((*path, key), f"has no meaning for a {section.type}", key=True)
            for key in ("minimum", "maximum")
            if getattr(section, key) is not None and not numeric
        ]
        if section.minimum is not None and section.maximum is not None and section.minimum > section.maximum:
            problems.append(tree.problem((*path, "maximum"), f"is below the minimum, {section.minimum:g}"))
        for index, choice in enumerate(section.choices):
            if (wrong := _type_problem(section, choice)) is not None:
                problems.append(tree.problem((*path, "choices", index), wrong))
        if section.default is not None and (wrong := parameter_problem(section, section.default)) is not None:
            problems.append(tree.problem((*path, "default"), wrong))
    return problems


def parameter_problem(section: ParameterSection, value: object) -> str | None:
    """Return why a parameter cannot have a value, or None."""
    if (wrong := _type_problem(section, value)) is not None:
        return wrong
    if section.choices and value not in section.choices:
        return f"must be one of {', '.join(map(_format, section.choices))}, not {_format(value)}"
    if isinstance(value, int | float) and not isinstance(value, bool):
        below = section.minimum is not None and value < section.minimum
        above = section.maximum is not None and value > section.maximum
        if below or above:
            return f"must be {describe(section)}, not {_format(value)}"
    return None


def _type_problem(section: ParameterSection, value: object) -> str | None:
    fits = {
        "int": isinstance(value, int) and not isinstance(value, bool),
        "double": isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= sys.float_info.max,
        "bool": isinstance(value, bool),
        "string": isinstance(value, str),
        "list": isinstance(value, tuple | list) and _is_finite(value),
    }[section.type]
    if fits:
        return None
    finite = " of finite numbers" if isinstance(value, tuple | list) and section.type == "list" else ""
    return f"must be {describe(section)}{finite}, not {_format(value)}"


def _is_finite(value: object) -> bool:
    if isinstance(value, tuple | list):
        return all(map(_is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


def describe(section: ParameterSection) -> str:
    """Return type, range and unit for people, such as `double 0.05..0.5 m/s`."""
    words = [section.type, range_text(section.minimum, section.maximum), "|".join(map(_format, section.choices or ()))]
    return " ".join(word for word in (*words, section.unit) if word)


def _format(value: object) -> str:
    try:
        return json.dumps(value) if isinstance(value, list | tuple) else show(value)
    except (TypeError, ValueError):  # a result of Python that has no form in a file
        return f"of type {type(value).__name__}"


# Units.


def unit_problem(value: object, file: ScenarioFile, wanted: str | None, what: str) -> str | None:
    """Return why a value has the wrong unit, or None. The unit is known only for a sole parameter."""
    unit = unit_of(value, file)
    if unit is None or not wanted or unit == wanted:
        return None
    return f"parameter '{_sole_name(value)}' is in {unit}, and {what} takes {wanted}"


def unit_of(value: object, file: ScenarioFile) -> str | None:
    """Return the unit of the parameter that a value consists of; None without one."""
    name = _sole_name(value)
    section = file.parameters.get(name) if name is not None else None
    return section.unit if section is not None else None


def _sole_name(value: object) -> str | None:
    """Return the only variable of a text; a literal text before it is allowed, as in `f${distance_m}`."""
    if not isinstance(value, str) or "${" not in value:
        return None
    expressions = [expression for expression, _ in parse_template(value).expressions()]
    tree = expressions[0].tree if len(expressions) == 1 else None
    return tree.id if isinstance(tree, ast.Name) else None


# Values.


def with_parameters(scenario: Scenario, given: Mapping[str, object]) -> Scenario:
    """Return a scenario with other values of its parameters; raise ConfigError if a name or a value is not allowed."""
    return set_parameters(scenario, {**scenario.parameters, **given}) if given else scenario


def set_parameters(scenario: Scenario, given: Mapping[str, object]) -> Scenario:
    """Return a scenario with these parameters, and the defaults of all others; raise as `with_parameters` does."""
    values: dict[str, object] = {}
    problems = []
    declared = scenario.file.parameters
    for name, section in declared.items():
        value = given.get(name, section.default)
        if value is None and name not in given:
            continue
        if name in given and (wrong := parameter_problem(section, value)) is not None:
            problems.append(scenario.problem(("parameters", name), f"{wrong} as it was given", key=True))
            continue
        values[name] = float(value) if section.type == "double" and isinstance(value, int) else _frozen(value)
    problems += [
        scenario.problem(
            ("parameters",) if declared else (),
            f"unknown parameter '{name}'{did_you_mean(name, declared) or '; the scenario has none'}",
            key=True,
        )
        for name in given
        if name not in declared
    ]
    if problems:
        raise ConfigError(problems)
    return replace(scenario, parameters=values)


def _frozen(value: object) -> object:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def missing_parameters(scenario: Scenario, values: Mapping[str, object]) -> list[Problem]:
    """Return a problem for each parameter without a value."""
    return [
        scenario.problem(
            ("parameters", name),
            f"has no default, so it must be given: --set {name}={_EXAMPLES[section.type]}",
            key=True,
        )
        for name, section in scenario.file.parameters.items()
        if name not in values
    ]


def read_settings(file: ScenarioFile, settings: Sequence[str]) -> dict[str, Any]:
    """Return the values of `name=value` texts from a command line.

    A value that cannot be read as the parameter's type stays a text, which `set_parameters` refuses. Raise ValueError
    if a text has no `=`, or a name comes twice.
    """
    values: dict[str, Any] = {}
    for setting in settings:
        name, equals, text = setting.partition("=")
        if not equals or not name.strip():
            raise ValueError(f"must be NAME=VALUE, not {setting!r}")
        if name.strip() in values:
            raise ValueError(f"gives '{name.strip()}' twice")
        section = file.parameters.get(name.strip())
        values[name.strip()] = _read(section.type, text.strip()) if section is not None else text
    return values


def _read(kind: str, text: str) -> Any:
    try:
        if kind == "int":
            return int(text)
        if kind == "double":
            return float(text)
        if kind == "list":
            return _read_list(text)
    except ValueError:
        return text
    return _TRUTHS.get(text, text) if kind == "bool" else text


def _read_list(text: str) -> list[Any]:
    """Read `[1, 2]` and `[[1, 2], [3, 4]]`, and `a,b` as two texts or numbers."""
    if text.startswith("["):
        items = read_brackets(text)
        rows = [row if isinstance(row, list) else [row] for row in items]
        if not all(isinstance(item, str | int | float) for row in rows for item in row):
            raise ValueError
        return list(items)
    return [_read_item(item.strip()) for item in text.split(",")] if text else []


def read_brackets(text: str) -> list[Any]:
    """Read a list in JSON, or in YAML, where texts need no quotes; raise ValueError if it is neither."""
    try:
        items = json.loads(text)
    except ValueError:
        try:
            items = parse_yaml(f"items: {text}", "list").root["items"]
        except ConfigError as error:
            raise ValueError(str(error)) from None
    if not isinstance(items, list):
        raise ValueError  # the text is wrong, not the type of an argument
    return items


def _read_item(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return _TRUTHS.get(text, text)
