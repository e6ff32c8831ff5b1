"""Scenarios given as text in a test."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Final

from eal_actors.scenario import Scenario, load_scenario, parse_scenario

_NAME: Final = "scenario"


def read_scenario(source: str | Path) -> Scenario:
    """Read a scenario from its text, which may be indented, or from its file.

    Args:
        source: text of more than one line, or else the path of a file.

    Raises:
        ConfigError: the scenario is wrong; names every problem.
    """
    if isinstance(source, Path) or "\n" not in source:
        return load_scenario(source)
    return parse_scenario(textwrap.dedent(source), _NAME)
