"""Strict YAML: the values of a file with their lines and columns.

Scalars follow the core schema of YAML 1.2: `yes`, `12:30` and `2024-01-01` are text. Input that PyYAML accepts silently
is a problem here: duplicate keys, keys that are no text, tags, merge keys, anchors that contain themselves or expand
without limit. All problems of a file are collected before they are raised.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, NoReturn

import yaml

from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.suggestions import nearest
from eal_actors.kernel.yaml_tree import Mark, MarkedDict, MarkedList, YamlPath, YamlTree, format_path, show
from eal_actors.kernel.yaml_words import explain


class Limits(NamedTuple):
    """The limits of a file.

    `size` is in bytes, each use of an anchor counts in `values`, and `depth` is that of mappings and lists.
    """

    size: int
    values: int
    depth: int


USUAL: Final = Limits(1_000_000, 20_000, 64)
LARGE: Final = Limits(8_000_000, 200_000, 128)
"""For files of ten thousand steps; a greater depth would overflow the stack of recursive code."""


def load_yaml(path: str | Path, *, environment: Mapping[str, str] | None = None) -> YamlTree:
    """Read a YAML file whose top level is a mapping; problems name it as it is given. See `parse_yaml`.

    Raises ConfigError with every problem of the file.
    """
    return parse_yaml(read_file(path), str(path), environment=environment)


def read_file(path: str | Path, limits: Limits = USUAL) -> bytes:
    """Return the content of a file, reading little more than the limits allow; ConfigError if it cannot be read."""
    name = str(path)
    try:
        with open(path, "rb", opener=_open_at_once) as stream:  # Path.open takes no opener
            return stream.read(limits.size + 1)
    except FileNotFoundError:
        beside = {file.stem: file.name for file in Path(name).parent.glob("*.y*ml")}
        near = nearest(Path(name).stem, beside)
        _refuse(name, "no such file" + (f"; did you mean '{beside[near]}'?" if near is not None else ""))
    except IsADirectoryError:
        _refuse(name, "is a folder, not a file")
    except OSError as error:
        _refuse(name, f"cannot be read: {os.strerror(error.errno) if error.errno else error}")


def _open_at_once(path: str, flags: int) -> int:
    """Open a file; without waiting for the writer of a named pipe, which reads as empty if it has none."""
    opened = os.open(path, flags | os.O_NONBLOCK)
    os.set_blocking(opened, True)
    return opened


def parse_yaml(
    text: str | bytes, name: str, *, environment: Mapping[str, str] | None = None, limits: Limits = USUAL
) -> YamlTree:
    """Read YAML from memory.

    Args:
        text: the content; bytes must be UTF-8.
        name: the file's name in problems.
        environment: replaces `${NAME}` and `${NAME:-default}` in values; `$${` is a literal `${`. A plain value that is
            one reference and nothing else gets its type from the replacement, so that a port can come from the
            environment. None leaves such text untouched.
        limits: the limits of the file.

    Raises ConfigError with every problem of the text.
    """
    content = text if isinstance(text, bytes) else text.encode(errors="surrogatepass")
    if len(content) > limits.size:
        _refuse(name, f"is larger than {limits.size} bytes")
    composer = _Composer(_decode(content, name), name, limits)
    node = composer.compose_top()
    builder = _ValueBuilder(name, environment, composer.problems, limits)
    if node is None or (isinstance(node, yaml.ScalarNode) and node.style is None and node.value == ""):
        _refuse(name, "is empty; the top level must be a mapping of keys to values")
    root = builder.build(node, ())
    if not isinstance(root, MarkedDict) and not builder.problems:
        builder.report(node, (), f"the top level must be a mapping of keys to values, not {show(root)}")
    if builder.problems or not isinstance(root, MarkedDict):
        raise ConfigError(tuple(builder.problems))
    return YamlTree(root)


def plain_value(text: str) -> str | int | float | bool | None:
    """Return the value of an unquoted YAML 1.2 scalar.

    Raises ValueError for a number that no 64-bit integer or finite float can hold.
    """
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _NOT_FINITE.fullmatch(text):
        raise ValueError(f"{text} is not a finite number; put it in quotes if it is meant as text")
    if _INTEGER.fullmatch(text):
        if len(text) > 20:  # int() would take quadratic time
            raise ValueError("the number does not fit into 64 bits")
        number = int(text.replace("0o", "", 1), 8) if "o" in text else int(text, 16 if "x" in text else 10)
        if not -(2**63) <= number < 2**63:
            raise ValueError("the number does not fit into 64 bits")
        return number
    if _FLOAT.fullmatch(text):
        value = float(text)
        if value in (float("inf"), float("-inf")):
            raise ValueError(f"{text} is too large for a number")
        return value
    return text


_CONSTANTS: Final[dict[str, bool | None]] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_INTEGER: Final = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT: Final = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE: Final = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_SURROGATE: Final = re.compile("[\ud800-\udfff]")
_REFERENCE: Final = re.compile(
    r"\$(?P<escape>\$\{)|\$\{(?:(?P<name>[A-Za-z_][A-Za-z0-9_]*)(?::-(?P<default>[^{}]*))?\})?"
)


def _refuse(name: str, message: str, line: int = 0, column: int = 0) -> NoReturn:
    raise ConfigError((Problem(name, line, column, "", message),))


def _decode(content: bytes, name: str) -> str:
    try:
        return content.decode("utf-8").removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        before = content[: error.start].decode("utf-8")
        line, column = _line_and_column(before, len(before))
        _refuse(name, f"is not UTF-8: byte 0x{content[error.start]:02x} at offset {error.start}", line, column)


def _line_and_column(text: str, position: int) -> tuple[int, int]:
    return text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)


class _Composer(yaml.BaseLoader):
    """PyYAML up to its node tree, with limits on depth and size, and without tags."""

    def __init__(self, text: str, name: str, limits: Limits) -> None:
        self.text = text
        self.file = name
        self.limits = limits
        self.problems: dict[Problem, None] = {}
        self._depth = 0
        self._values = 0

    def compose_top(self) -> yaml.Node | None:
        """Return the top node, or None for an empty file."""
        try:
            super().__init__(self.text)
            return self.get_single_node()
        except ConfigError:
            raise
        except yaml.reader.ReaderError as error:
            line, column = _line_and_column(self.text, error.position)
            self._give_up(f"the character U+{ord(self.text[error.position]):04X} is not allowed in YAML", line, column)
        except yaml.MarkedYAMLError as error:
            self._give_up(*explain(error, self.text))
        except (ValueError, OverflowError):  # chr() of an escape such as "\UFFFFFFFF"
            self._give_up("the escape is no valid character", self.line + 1, self.column + 1)

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node; overrides PyYAML's method, which also calls it for each child."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        line, column = event.start_mark.line + 1, event.start_mark.column + 1
        if getattr(event, "tag", None) is not None:
            message = f"the tag {event.tag} is not supported; leave it out, and put text in quotes"
            self.problems[Problem(self.file, line, column, "", message)] = None
        self._depth += 1
        self._values += 1
        if self._depth > self.limits.depth:
            self._give_up(f"is nested more than {self.limits.depth} levels deep", line, column)
        if self._values > 2 * self.limits.values:  # keys count here too
            self._give_up(f"has more than {self.limits.values} values", line, column)
        node: yaml.Node | None = super().compose_node(parent, index)
        self._depth -= 1
        return node

    def _give_up(self, message: str, line: int, column: int) -> NoReturn:
        raise ConfigError((*self.problems, Problem(self.file, line, column, "", message)))


class _ValueBuilder:
    """Builds marked values from PyYAML's nodes."""

    def __init__(
        self, file: str, environment: Mapping[str, str] | None, problems: dict[Problem, None], limits: Limits
    ) -> None:
        self.problems = problems  # a dict: an anchor's problems appear at each of its uses, but count once
        self._file = file
        self._environment = environment
        self._most_values = limits.values
        self._open: set[int] = set()
        self._values = 0
        self._reported: set[tuple[int, int, str]] = set()

    def report(self, node: yaml.Node, path: YamlPath, message: str) -> None:
        """Record a problem, once for each place."""
        mark = self._mark(node)
        if (mark.line, mark.column, message) not in self._reported:
            self._reported.add((mark.line, mark.column, message))
            self.problems[Problem(mark.file, mark.line, mark.column, format_path(path), message)] = None

    def build(self, node: yaml.Node, path: YamlPath) -> Any:
        self._values += 1
        if self._values > self._most_values:
            self.report(node, (), f"the file has more than {self._most_values} values, each use of an anchor counted")
            raise ConfigError(tuple(self.problems))
        if isinstance(node, yaml.ScalarNode):
            return self._scalar(node, path)
        if id(node) in self._open:
            self.report(node, path, "the anchor contains itself")
            return None
        self._open.add(id(node))
        value = self._mapping(node, path) if isinstance(node, yaml.MappingNode) else self._list(node, path)
        self._open.remove(id(node))
        return value

    def _mark(self, node: yaml.Node) -> Mark:
        return Mark(self._file, node.start_mark.line + 1, node.start_mark.column + 1)

    def _list(self, node: yaml.Node, path: YamlPath) -> MarkedList:
        items = MarkedList(self._mark(node))
        for index, child in enumerate(node.value):
            items.put(self.build(child, (*path, index)), self._mark(child))
        return items

    def _mapping(self, node: yaml.Node, path: YamlPath) -> MarkedDict:
        mapping = MarkedDict(self._mark(node))
        for key_node, child in node.value:
            if (key := self._key(key_node, child, path)) is None:
                continue
            if key in mapping:
                first = mapping.key_marks[key]
                self.report(key_node, (*path, key), f"duplicate key; first defined in line {first.line}")
            value = self.build(child, (*path, key))
            mapping.put(key, value, self._mark(key_node), self._mark(child))
        return mapping

    def _key(self, node: yaml.Node, value: yaml.Node, path: YamlPath) -> str | None:
        if not isinstance(node, yaml.ScalarNode):
            self.report(node, path, "a key must be text, not a list or mapping")
            return None
        text = str(node.value)
        if node.style is not None:
            return self._checked_text(text, node, path)
        if text == "<<":
            self.report(node, path, "merge keys (<<) are not supported; share settings through `types` or `include`")
            return None
        try:
            is_text = isinstance(plain_value(text), str)
        except ValueError:
            is_text = False
        if not is_text:
            shown = f"{text} is not; write it in quotes: '{text}'" if text else "this one is empty"
            if text.isdecimal() and value.value == "":  # `{x_m: 1,5}`
                shown = f"{text} is not; a decimal number has a point, not a comma"
            self.report(node, path, f"a key must be text, and {shown}")
            return None
        return text

    def _scalar(self, node: yaml.ScalarNode, path: YamlPath) -> str | int | float | bool | None:
        text, plain = str(node.value), node.style is None
        if self._environment is not None and "${" in text:
            whole = _REFERENCE.fullmatch(text)
            plain = plain and whole is not None and whole["name"] is not None
            text = _REFERENCE.sub(lambda match: self._reference(match, node, path), text)
        self._checked_text(text, node, path)
        if not plain:
            return text
        try:
            return plain_value(text)
        except ValueError as error:
            self.report(node, path, str(error))
            return None

    def _reference(self, match: re.Match[str], node: yaml.Node, path: YamlPath) -> str:
        if match["escape"]:
            return match["escape"]
        name, default = match["name"], match["default"]
        if name is None:
            self.report(node, path, "${ must go on as ${NAME} or ${NAME:-default}; write $${ for a literal ${")
            return ""
        found = (self._environment or {}).get(name)
        if default is not None:
            return found or default
        if found is None:
            hint = f"set it, or give a default: ${{{name}:-default}}"
            self.report(node, path, f"the environment variable {name} is not set; {hint}")
        return found or ""

    def _checked_text(self, text: str, node: yaml.Node, path: YamlPath) -> str:
        if _SURROGATE.search(text):
            self.report(node, path, "the text holds half a character (a surrogate), which no file can store")
        return text
