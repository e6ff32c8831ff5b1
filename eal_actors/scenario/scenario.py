"""A scenario read from its file, and everything that can be wrong with it by itself."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from eal_actors.errors import ConfigError, Problem
from eal_actors.scenario.model import ScenarioFile
from eal_actors.scenario.scope_check import check_scope
from eal_actors.strict_model import problems_from
from eal_actors.yaml_source import load_yaml
from eal_actors.yaml_tree import YamlTree


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario without problems of its own.

    Attributes:
        source: the file it was read from, as the user gave it.
        file: what it says.
        tree: the same with the places in the file.
    """

    source: Path
    file: ScenarioFile
    tree: YamlTree

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.file.name


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file. The environment has no say in it.

    Args:
        path: the scenario file.

    Raises:
        ConfigError: with every problem of the file.
    """
    tree = load_yaml(path)
    try:
        file = ScenarioFile.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, ScenarioFile)) from None
    if problems := check_scope(file, tree):
        raise ConfigError(problems)
    return Scenario(Path(path), file, tree)


def check_scenario(path: str | Path) -> tuple[Problem, ...]:
    """Return every problem of a scenario file, as far as it can be told without a fleet."""
    try:
        load_scenario(path)
    except ConfigError as error:
        return error.problems
    return ()


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of scenario files, for editors that complete and check while one types."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **ScenarioFile.model_json_schema()}
