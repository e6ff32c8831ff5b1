"""Varied parameters of a sweep: ranges and lists of values, parsed from the command line and checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.scenario import Scenario
from eal_actors.scenario.language.parameters import parameter_problem, read_brackets, read_settings
from eal_actors.scenario.language.sections import ParameterSection


@dataclass(frozen=True, slots=True)
class Variation:
    """A varied parameter, with its distinct values in the given order."""

    name: str
    values: tuple[Any, ...]


def read_variations(scenario: Scenario, texts: Sequence[str], most: int) -> tuple[Variation, ...]:
    """Parse `name=1,2,3` and `name=0.1:0.5:0.1`; a range includes both ends, and integers need no step.

    A range has at most `most` values.

    Raises:
        ValueError: a text is malformed; the message quotes it.
        ConfigError: the scenario has no such parameter, or a value is not valid for it.
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
            hint = did_you_mean(name, scenario.file.parameters) or "; the scenario has none"
            path = ("parameters",) if scenario.file.parameters else ()
            problems.append(scenario.problem(path, f"there is no parameter '{name}' to vary{hint}", key=True))
            continue
        values = _parse_values(scenario, name, section, values_text, most)
        variations.append(Variation(name, values))
        problems += [
            scenario.problem(("parameters", name), f"{wrong}; --vary sets it", key=True)
            for value in values
            if (wrong := parameter_problem(section, value)) is not None
        ]
    if problems:
        raise ConfigError(problems)
    return tuple(variations)


def read_seeds(text: str, most: int) -> tuple[int, ...]:
    """Parse seeds such as `1:20`, `1,5,9`, `7` or `1:5,9`; raise ValueError if they are malformed, or over `most`."""
    seeds: list[int] = []
    for part in text.split(","):
        first, colon, last = (item.strip() for item in part.partition(":"))
        if not first.isdecimal() or (colon and not last.isdecimal()) or (colon and int(last) < int(first)):
            raise ValueError(f"must be seeds such as 1:20 or 1,5,9, whole numbers of at least 0, not {text!r}")
        if int(last or first) - int(first) >= most:
            raise ValueError(f"{part.strip()!r} is more than {most} seeds; --limit allows more")
        seeds += range(int(first), int(last or first) + 1)
    return tuple(_require_distinct(seeds, "seed"))


def _parse_values(scenario: Scenario, name: str, section: ParameterSection, text: str, most: int) -> tuple[Any, ...]:
    if section.type in ("int", "double") and ":" in text:
        values: list[Any] = _parse_range(name, section.type, text, most)
    elif section.type == "list":
        values = _parse_lists(name, text)
    else:
        given = [read_settings(scenario.file, [f"{name}={part.strip()}"])[name] for part in text.split(",")]
        is_double = section.type == "double"
        values = [float(value) if is_double and isinstance(value, int) else value for value in given]
    return tuple(_require_distinct(values, f"value of '{name}'"))


def _parse_range(name: str, kind: str, text: str, most: int) -> list[Any]:
    numbers = _parse_numbers(text)
    if len(numbers) == 2 and kind == "int":
        numbers.append(Decimal(1))
    if len(numbers) != 3:
        step = "" if kind == "int" else ":STEP"
        raise ValueError(f"'{name}' must be FROM:TO{step} in numbers, not {text!r}")
    first, last, step_by = numbers
    if step_by <= 0 or last < first:
        raise ValueError(f"'{name}' must go up from FROM to TO by a STEP over 0, not {text!r}")
    if kind == "int" and any(number % 1 for number in numbers):
        raise ValueError(f"'{name}' is a whole number, and so are the parts of its range, not {text!r}")
    count = int((last - first) / step_by) + 1
    if count > most:
        raise ValueError(f"'{name}' has {count} values, more than {most} runs; --limit allows more")
    make = int if kind == "int" else float
    return [make(first + number * step_by) for number in range(count)]


def _parse_numbers(text: str) -> list[Decimal]:
    """Return the finite numbers of a range; none if one of its parts is not a finite number."""
    try:
        numbers = [Decimal(part.strip()) for part in text.split(":")]
    except InvalidOperation:
        return []
    return numbers if all(number.is_finite() for number in numbers) else []


def _parse_lists(name: str, text: str) -> list[Any]:
    try:
        values = read_brackets(text)
    except ValueError:
        values = [None]
    if not all(isinstance(value, list) for value in values):
        raise ValueError(f"'{name}' is a list, so it takes lists such as [[1, 2], [3]], not {text!r}")
    return [tuple(value) for value in values]


def _require_distinct(values: Sequence[Any], what: str) -> Sequence[Any]:
    for index, value in enumerate(values):
        if value in values[:index]:
            raise ValueError(f"gives the {what} {value!r} twice")
    return values
