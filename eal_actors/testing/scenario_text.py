"""Scenarios that stand in a test as text."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Final

from eal_actors.scenario import Scenario, load_scenario, parse_scenario

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
    return parse_scenario(textwrap.dedent(source), _NAME)
