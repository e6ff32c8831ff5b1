"""The content of a file that is given in memory, as the tree of a file."""

from __future__ import annotations

import os
from collections.abc import Mapping

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.yaml_tree import Mark, MarkedDict, MarkedList, YamlPath, YamlTree, format_path, show


def tree_of(content: Mapping[str, object], name: str) -> YamlTree:
    """Return content given in memory as the tree of a file, so that the checks are the same.

    Args:
        content: values that YAML can hold: text, numbers, true, false and null, in lists and in mappings with text as
            keys. Tuples become lists, and paths become text.
        name: its name in problems. It has no lines; paths in it are relative to the working directory.

    Raises ConfigError with every value that YAML cannot hold.
    """
    copier = _Copier(Mark(name, 0, 0))
    root = copier.mapping(content, ())
    if copier.problems:
        raise ConfigError(copier.problems)
    return YamlTree(root)


class _Copier:
    """Copies plain values into marked ones, all with the same mark."""

    def __init__(self, mark: Mark) -> None:
        self.problems: list[Problem] = []
        self._mark = mark

    def mapping(self, content: Mapping[str, object], path: YamlPath) -> MarkedDict:
        """Return a copy of a mapping, and note its problems."""
        copy = MarkedDict(self._mark)
        for key, value in content.items():
            if isinstance(key, str):
                copy.put(key, self._value(value, (*path, key)), self._mark, self._mark)
            else:
                self._note(path, f"a key must be text, not {show(key)}")
        return copy

    def _value(self, value: object, path: YamlPath) -> object:
        if isinstance(value, Mapping):
            return self.mapping(value, path)
        if isinstance(value, list | tuple):
            items = MarkedList(self._mark)
            for index, item in enumerate(value):
                items.put(self._value(item, (*path, index)), self._mark)
            return items
        if isinstance(value, os.PathLike):
            return os.fspath(value)
        if not isinstance(value, str | int | float | None):
            self._note(path, f"must be what YAML can hold, not {type(value).__name__}: {show(value)}")
        return value

    def _note(self, path: YamlPath, message: str) -> None:
        self.problems.append(Problem(self._mark.file, 0, 0, format_path(path), message))
