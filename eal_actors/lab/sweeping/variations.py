"""What is varied: ranges and lists of values as a command line has them, held against the scenario's parameters."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.strict_model import did_you_mean
from eal_actors.scenario import Scenario
from eal_actors.scenario.language.parameters import parameter_problem, read_settings
from eal_actors.scenario.language.scenario import ParameterSection


@dataclass(frozen=True, slots=True)
class Variation:
    """A parameter, and the values that it takes.

    Attributes:
        name: of the parameter.
        values: each once, in the order given.
    """

    name: str
    values: tuple[Any, ...]


def read_variations(scenario: Scenario, texts: Sequence[str], most: int) -> tuple[Variation, ...]:
    """Read `name=1,2,3`, or `name=0.1:0.5:0.1` with both ends, of which the step may be left out for whole numbers.

    Args:
        scenario: the scenario that has the parameters.
        texts: as given.
        most: a range of more values than this is refused.

    Raises:
        ValueError: a text says nothing that can be understood; the message names it.
        ConfigError: a parameter that the scenario does not have, or values that it may not have.
    """
    variations: list[Variation] = []
    problems: list[Problem] = []
    for text in texts:
        name, equals, values_text = (part.strip() for part in text.partition("="))
        if not equals or not name or not values_text:
            raise ValueError(f"must be NAME=FROM:TO:STEP or NAME=VALUE,VALUE, not {text!r}")
        if any(known.name == name for known in variations):
            raise ValueError(f"varies '{name}' twice")
        section = scenario.file.parameters.get(name)
        if section is None:
            known_names = did_you_mean(name, scenario.file.parameters) or "; the scenario has none"
            problems.append(_lacks(scenario, f"there is no parameter '{name}' to vary{known_names}"))
            continue
        values = _values(scenario, name, section, values_text, most)
        variations.append(Variation(name, values))
        problems += [
            scenario.problem(("parameters", name), f"{wrong}, which --vary gives it", key=True)
            for value in values
            if (wrong := parameter_problem(section, value)) is not None
        ]
    if problems:
        raise ConfigError(problems)
    return tuple(variations)


def read_seeds(text: str, most: int) -> tuple[int, ...]:
    """Read `1:20`, `1,5,9` or `7`, or ranges among others: `1:5,9`.

    Raises:
        ValueError: it is none of these; or more seeds than `most`.
    """
    seeds: list[int] = []
    for part in text.split(","):
        first, colon, last = (item.strip() for item in part.partition(":"))
        if not first.isdecimal() or (colon and not last.isdecimal()) or (colon and int(last) < int(first)):
            raise ValueError(f"must be seeds such as 1:20 or 1,5,9, whole numbers of at least 0, not {text!r}")
        if int(last or first) - int(first) >= most:
            raise ValueError(f"{part.strip()!r} is more than {most} seeds; --limit allows more")
        seeds += range(int(first), int(last or first) + 1)
    return tuple(_each_once(seeds, "seed"))


def _lacks(scenario: Scenario, message: str) -> Problem:
    return scenario.problem(("parameters",) if scenario.file.parameters else (), message, key=True)


def _values(scenario: Scenario, name: str, section: ParameterSection, text: str, most: int) -> tuple[Any, ...]:
    if section.type in ("int", "double") and ":" in text:
        values: list[Any] = _range(name, section, text, most)
    elif section.type == "list":
        values = _lists(name, text)
    else:
        given = [read_settings(scenario.file, [f"{name}={part.strip()}"])[name] for part in text.split(",")]
        is_whole = section.type == "double"
        values = [float(value) if is_whole and isinstance(value, int) else value for value in given]
    return tuple(_each_once(values, f"value of '{name}'"))


def _range(name: str, section: ParameterSection, text: str, most: int) -> list[Any]:
    parts = text.split(":")
    try:
        numbers = [Decimal(part.strip()) for part in parts]
    except InvalidOperation:
        numbers = []
    if len(numbers) == 2 and section.type == "int":
        numbers.append(Decimal(1))
    if len(numbers) != 3 or not all(number.is_finite() for number in numbers):
        step = "" if section.type == "int" else ":STEP"
        raise ValueError(f"'{name}' must go FROM:TO{step} in numbers, not {text!r}")
    first, last, step_by = numbers
    if step_by <= 0 or last < first:
        raise ValueError(f"'{name}' must go up from FROM to TO by a STEP over 0, not {text!r}")
    if section.type == "int" and any(number % 1 for number in numbers):
        raise ValueError(f"'{name}' is a whole number, and so are the parts of its range, not {text!r}")
    count = int((last - first) / step_by) + 1
    if count > most:
        raise ValueError(f"'{name}' takes {count} values, more than {most} runs; --limit allows more")
    kind = int if section.type == "int" else float
    return [kind(first + number * step_by) for number in range(count)]


def _lists(name: str, text: str) -> list[Any]:
    try:
        values = json.loads(text)
    except ValueError:
        values = None
    if not isinstance(values, list) or not all(isinstance(value, list) for value in values):
        raise ValueError(f"'{name}' is a list, so it takes lists such as [[1, 2], [3]], not {text!r}")
    return [tuple(value) for value in values]


def _each_once(values: Sequence[Any], what: str) -> Sequence[Any]:
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ValueError(f"gives the {what} {value!r} twice")
    return values
