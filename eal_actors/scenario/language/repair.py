"""Repair of an invalid file, so that the checks that come after its validation report their problems as well.

Each invalid value is removed, or replaced by one that is valid in its place. The result is only good for more checks.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.strict_model import model_of
from eal_actors.kernel.yaml_tree import MarkedDict, MarkedList, YamlPath, YamlTree, parse_path, replace_text
from eal_actors.scenario.language.scenario import ScenarioFile

_ROUNDS: Final = 20
_MOST_PROBLEMS: Final = 1000
_NAME: Final = re.compile(r"[A-Za-z_]\w*")
_STEP: Final = {"log": "x"}
_VALUES: Final[tuple[Callable[[], Any], ...]] = (
    lambda: 1,
    lambda: dict(_STEP),
    lambda: "x",
    lambda: [dict(_STEP)],
    lambda: {"x": 1},
    lambda: {"x": [1]},
    lambda: {"x": {}},
    lambda: ["x"],
)
"""Values, one of which is valid in almost every place."""


@dataclass(frozen=True, slots=True)
class RepairedFile:
    """A file made valid: the paths of values that were invalid, and all words in them, perhaps names in the rest."""

    file: ScenarioFile
    paths: frozenset[YamlPath]
    names: frozenset[str]

    def concerns(self, problem: Problem) -> bool:
        """Return whether a problem may be due to the repair."""
        path = parse_path(problem.path)
        return any(path[: len(repaired)] == repaired for repaired in self.paths)


def repair(tree: YamlTree, problems: Sequence[Problem]) -> RepairedFile | None:
    """Return a file made valid by the problems of its validation; None if that takes too long."""
    copy = YamlTree(replace_text(tree.root, lambda text: text), tree.prefix)
    tried: dict[YamlPath, int] = {}
    names: set[str] = set()
    for _ in range(_ROUNDS):
        if len(problems) > _MOST_PROBLEMS:
            return None
        for path, message in {parse_path(problem.path): problem.message for problem in problems}.items():
            _replace(copy.root, path, tried, names, remove=message.startswith("unknown key"))
        try:
            return RepairedFile(model_of(ScenarioFile, copy), frozenset(tried), frozenset(names))
        except ConfigError as error:
            problems = error.problems
    return None


def _replace(root: MarkedDict, path: YamlPath, tried: dict[YamlPath, int], names: set[str], *, remove: bool) -> None:
    """Replace a value by the next one to try; if none is left, or at once, remove it, or replace the one around it."""
    while path:
        node, key = _find(root, path[:-1]), path[-1]
        number = len(_VALUES) if remove and path not in tried else tried.get(path, 0)
        tried[path] = number + 1
        if isinstance(node, MarkedList) and isinstance(key, int) and key < len(node):
            names.update(_words(node[key]))
            if number < len(_VALUES):
                node[key] = _VALUES[number]()
                return
        elif isinstance(node, MarkedDict) and isinstance(key, str):
            is_there = key in node
            names.update(_words({key: node[key]}) if is_there else ())
            if number < len(_VALUES):
                node.put(key, _VALUES[number](), node.mark, node.mark)
                return
            if is_there and number == len(_VALUES):
                del node[key]
                return
        path, remove = path[:-1], False


def _find(root: MarkedDict, path: YamlPath) -> object:
    """Return the value at a path; None if there is none, as for a key with a dot in its name."""
    node: Any = root
    try:
        for key in path:
            node = node[key]
    except (LookupError, TypeError):
        return None
    return node


def _words(value: object) -> Iterator[str]:
    """Yield the words in all keys and texts of a value."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _words(str(key))
            yield from _words(item)
    elif isinstance(value, list):
        for item in value:
            yield from _words(item)
    elif isinstance(value, str):
        yield from _NAME.findall(value)
