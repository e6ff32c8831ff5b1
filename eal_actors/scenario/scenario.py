"""A scenario read from its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.yaml_tree import YamlPath, YamlTree
from eal_actors.scenario.model import ScenarioFile
from eal_actors.scenario.source import Source


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scenario without problems of its own.

    Attributes:
        source: the file it was read from, as the user gave it.
        file: what it says.
        tree: the same with the places in the file.
        lines: the file's lines.
        parameters: the values of its parameters, defaults included; those that still must be given are missing.
        parts: the scenarios that it carries out, by the paths of the steps that do so.
        size: how many steps it has, those of its parts included.
    """

    source: Path
    file: ScenarioFile
    tree: YamlTree
    lines: tuple[str, ...] = ()
    parameters: Mapping[str, object] = field(default_factory=dict)
    parts: Mapping[str, Scenario] = field(default_factory=dict)
    size: int = 0

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.file.name

    def problem(
        self, path: YamlPath, message: str, *, key: bool = False, inside: tuple[str, int] | None = None
    ) -> Problem:
        """Return a problem with a value of its file; see Source."""
        return Source(self.tree, self.lines).problem(path, message, key=key, inside=inside)
