"""Values read from YAML, with their file, line and column, also after files were merged."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from eal_actors.kernel.errors import Problem

_ELEMENT: Final = re.compile(r"\[(\d+)\]|([^.\[\]]+)")

YamlPath = tuple[str | int, ...]
"""The keys and list indexes from the top of a file to a value."""


@dataclass(frozen=True, slots=True)
class Mark:
    """A place in a file; line and column count from 1."""

    file: str
    line: int
    column: int


class MarkedDict(dict[str, Any]):
    """A mapping with the place of each key and value."""

    __slots__ = ("key_marks", "mark", "value_marks")

    def __init__(self, mark: Mark) -> None:
        super().__init__()
        self.mark = mark
        self.key_marks: dict[str, Mark] = {}
        self.value_marks: dict[str, Mark] = {}

    def put(self, key: str, value: object, key_mark: Mark, value_mark: Mark) -> None:
        """Set a key together with the places of its name and its value."""
        self[key] = value
        self.key_marks[key] = key_mark
        self.value_marks[key] = value_mark

    def section(self, key: str) -> MarkedDict:
        """Return the mapping at a key; an empty one where there is none."""
        found = self.get(key)
        return found if isinstance(found, MarkedDict) else MarkedDict(self.mark)

    def marked_items(self) -> Iterator[tuple[str, Any, Mark, Mark]]:
        """Yield key, value, mark of the key and mark of the value."""
        for key, value in self.items():
            yield key, value, self.key_marks[key], self.value_marks[key]


class MarkedList(list[Any]):
    """A list with the place of each item."""

    __slots__ = ("mark", "marks")

    def __init__(self, mark: Mark) -> None:
        super().__init__()
        self.mark = mark
        self.marks: list[Mark] = []

    def put(self, value: object, mark: Mark) -> None:
        """Append an item together with its place."""
        self.append(value)
        self.marks.append(mark)


def plain(value: Any) -> Any:
    """Return a copy of a tree without places, for writers of YAML or JSON."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [plain(item) for item in value]
    return value


def merge(base: MarkedDict, over: MarkedDict) -> MarkedDict:
    """Return a new mapping: mappings merge key by key, any other value of `over` replaces that of `base`.

    Every key and value keeps its place.
    """
    merged = MarkedDict(over.mark)
    for key, value, key_mark, value_mark in (*base.marked_items(), *over.marked_items()):
        below = merged.get(key)
        if isinstance(below, MarkedDict) and isinstance(value, MarkedDict):
            value = merge(below, value)
        merged.put(key, value, key_mark, value_mark)
    return merged


def replace_text(value: Any, replace: Callable[[str], str]) -> Any:
    """Return a copy of a marked value with `replace` applied to every text except keys."""
    if isinstance(value, str):
        return replace(value)
    if isinstance(value, MarkedDict):
        mapping = MarkedDict(value.mark)
        for key, item, key_mark, value_mark in value.marked_items():
            mapping.put(key, replace_text(item, replace), key_mark, value_mark)
        return mapping
    if isinstance(value, MarkedList):
        items = MarkedList(value.mark)
        for item, mark in zip(value, value.marks, strict=True):
            items.put(replace_text(item, replace), mark)
        return items
    return value


def format_path(path: YamlPath) -> str:
    """Return a path as text, such as `robots.evbot1.tags[0]`."""
    text = ""
    for element in path:
        text += f"[{element}]" if isinstance(element, int) else f".{element}" if text else element
    return text


def parse_path(text: str) -> YamlPath:
    """Return the path of a text such as `steps[0].do[1]`; the opposite of `format_path`."""
    return tuple(int(index) if index else name for index, name in _ELEMENT.findall(text))


@dataclass(frozen=True, slots=True)
class YamlTree:
    """A mapping read from YAML: a whole file or a part of one.

    `prefix` is the path of `root` in its file; paths in problems start with it.
    """

    root: MarkedDict
    prefix: YamlPath = ()

    def mark_at(self, path: YamlPath, *, key: bool = False) -> Mark:
        """Return the place of the value at a path, such as a pydantic `loc`, or that of the path's last key.

        Elements that are not in the file (a missing key, the tag of a union) are skipped, so the result is the nearest
        enclosing value.
        """
        node: object = self.root
        mark = self.root.mark
        for position, element in enumerate(path):
            if isinstance(node, MarkedDict) and element in node:
                name = str(element)
                wants_key = key and position == len(path) - 1
                mark = node.key_marks[name] if wants_key else node.value_marks[name]
                node = node[name]
            elif isinstance(node, MarkedList) and isinstance(element, int) and element < len(node):
                mark, node = node.marks[element], node[element]
        return mark

    def problem(self, path: YamlPath, message: str, *, key: bool = False) -> Problem:
        """Return a problem with the value, or the key, at a path from `root`."""
        mark = self.mark_at(path, key=key)
        return Problem(mark.file, mark.line, mark.column, format_path(self.prefix + path), message)


def show(value: object) -> str:
    """Return a value of a file as text for messages: `'text'`, `5`, `true`, `a list`."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "a mapping"
    if isinstance(value, list | tuple):
        return "a list"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def texts_in(value: object) -> Iterator[str]:
    """Yield every text in nested mappings and lists."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for part in value.values():
            yield from texts_in(part)
    elif isinstance(value, list | tuple):
        for part in value:
            yield from texts_in(part)
