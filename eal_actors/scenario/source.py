"""Where in a scenario's file things stand, down to the column inside a text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from eal_actors.kernel.errors import Problem
from eal_actors.kernel.yaml_tree import YamlPath, YamlTree, format_path


@dataclass(frozen=True, slots=True)
class Source:
    """A file's values and its lines.

    Attributes:
        tree: the values, with the places at which they begin.
        lines: the text.
    """

    tree: YamlTree
    lines: Sequence[str]

    def problem(
        self, path: YamlPath, message: str, *, key: bool = False, inside: tuple[str, int] | None = None
    ) -> Problem:
        """Return a problem with the value, or the key, at a path.

        Args:
            path: from the top of the file.
            message: what is wrong.
            key: whether the key is meant.
            inside: the value, a text, and the offset in it where the problem lies.
        """
        mark = self.tree.mark_at(path, key=key)
        shift = 0 if inside is None else self._shift(mark.line, mark.column, *inside)
        return Problem(mark.file, mark.line, mark.column + shift, format_path(path), message)

    def _shift(self, line: int, column: int, text: str, offset: int) -> int:
        """Return how many columns after its beginning a text's offset stands; 0 where the file writes it otherwise."""
        if not 0 < line <= len(self.lines):
            return 0
        written = self.lines[line - 1][column - 1 :]
        quote = written[:1] in ("'", '"')
        if not written[quote:].startswith(text[: offset + 1]):  # escapes, or a text of several lines
            return 0
        return quote + offset
