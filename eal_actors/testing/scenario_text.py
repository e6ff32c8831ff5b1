"""Scenarios that stand in a test as text."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Final

from pydantic import ValidationError

from eal_actors.errors import ConfigError
from eal_actors.scenario import Scenario, load_scenario
from eal_actors.scenario.model import ScenarioFile
from eal_actors.scenario.scope_check import check_scope
from eal_actors.strict_model import problems_from
from eal_actors.yaml_source import parse_yaml

_NAME: Final = "scenario"


def read_scenario(source: str | Path) -> Scenario:
    """Read a scenario from its text, which may be indented as a whole, or from its file.

    Args:
        source: text of more than one line; anything else is the path of a file.

    Raises:
        ConfigError: with every problem of the scenario.
    """
    if isinstance(source, Path) or "\n" not in source:
        return load_scenario(source)
    tree = parse_yaml(textwrap.dedent(source), _NAME)
    try:
        file = ScenarioFile.model_validate(tree.root)
    except ValidationError as error:
        raise ConfigError(problems_from(error, tree, ScenarioFile)) from None
    if problems := check_scope(file, tree):
        raise ConfigError(problems)
    return Scenario(Path(_NAME), file, tree)
