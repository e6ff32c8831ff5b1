"""Changes of a fleet file as text, so that all of its author's lines and comments stay the same."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from eal_actors.kernel.bundled import is_installed
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.kernel.yaml_tree import MarkedDict
from eal_actors.managers.fleet_model import FleetConfig


@contextmanager
def changed_files(texts: Mapping[Path, str]) -> Iterator[None]:
    """Replace the texts of files, each atomically; an error in the block restores all of them.

    Raises:
        ConfigError: a file cannot be read or written.
    """
    before = {file: read_text(file) for file in texts}
    try:
        for file, text in texts.items():
            if text != before[file]:
                _replace_file(file, text)
        yield
    except BaseException:
        for file, former in before.items():
            _restore(file, former)
        raise


def require_own(fleet: FleetConfig) -> None:
    """Raise ConfigError if the fleet file is part of the installed framework."""
    if is_installed(fleet.source):
        name = fleet.source.stem
        message = (
            "is part of the framework and is not changed: write your own fleet file "
            f"with `include: [{name}]` below `version: 1`, and calibrate with that"
        )
        raise ConfigError([Problem(str(fleet.source), 0, 0, "", message)])


def with_include(text: str, name: str, include: str) -> str:
    """Return a fleet file's text with one more include after all others, otherwise unchanged.

    Args:
        text: text of a valid fleet file.
        name: name of the file in error messages.
        include: the file to include.

    Raises:
        ConfigError: the layout of the file allows no automatic change.
    """
    root = parse_yaml(text, name).root
    known = root.get("include")
    if known is not None and include in known:
        return text
    lines = f"{text}{'' if text.endswith(chr(10)) else chr(10)}".splitlines(keepends=True)
    if not known:
        if known is None:
            mark = root.value_marks["version"]
            lines.insert(mark.line, f"include: [{include}]\n")
        new = "".join(lines)
    else:
        mark = known.marks[-1]
        line = lines[mark.line - 1]
        lead = line[: mark.column - 1]
        if lead.strip() == "-":
            lines.insert(mark.line, f"{lead}{include}\n")
        else:
            end = line.find("]", mark.column - 1)
            lines[mark.line - 1] = f"{line[:end]}, {include}{line[end:]}" if end > 0 else line
        new = "".join(lines)
    _require_only_included(root, new, name, include)
    return new


def _require_only_included(before: MarkedDict, new: str, name: str, include: str) -> None:
    """Raise ConfigError unless a text has the former content and one include more."""
    wanted: dict[str, Any] = {**before, "include": [*(before.get("include") or ()), include]}
    try:
        is_so = parse_yaml(new, name).root == wanted
    except ConfigError:
        is_so = False
    if not is_so:
        message = f"cannot be changed automatically: add {include} to the end of its list, then try again"
        raise ConfigError([Problem(name, 0, 0, "include", message)])


def read_text(file: Path) -> str | None:
    """Return the text of a file, None without one.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _unwritable(file, error) from error


def _restore(file: Path, text: str | None) -> None:
    if text is None:
        file.unlink(missing_ok=True)
    elif read_text(file) != text:
        _replace_file(file, text)


def _replace_file(file: Path, text: str) -> None:
    """Replace a file atomically, keeping its permissions."""
    trial = file.with_name(f".{file.name}.new")
    try:
        trial.write_text(text, encoding="utf-8")
        if file.exists():
            trial.chmod(file.stat().st_mode & 0o777)
        trial.replace(os.path.realpath(file))
    except OSError as error:
        with suppress(OSError):
            trial.unlink(missing_ok=True)
        raise _unwritable(file, error) from error


def _unwritable(file: Path, error: OSError) -> ConfigError:
    return ConfigError([Problem(str(file), 0, 0, "", f"cannot be written: {error.strerror}")])
