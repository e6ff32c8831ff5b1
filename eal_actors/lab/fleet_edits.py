"""Changes of a fleet file as text, so that all of its author's lines and comments stay the same."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from textwrap import dedent, indent
from typing import Any, Final, TextIO

import yaml

from eal_actors.kernel.bundled import is_installed
from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import ConfigError, file_error, unwritable_error, writing
from eal_actors.kernel.posix import lock
from eal_actors.kernel.yaml_source import parse_yaml
from eal_actors.kernel.yaml_tree import MarkedDict
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.network_model import new_identity

_LOCKED_S: Final = 5.0
"""Real seconds to wait for another process that changes the file."""
_LOOK_S: Final = 0.05


@contextmanager
def changed_files(texts: Mapping[Path, str]) -> Iterator[None]:
    """Replace the texts of files, each atomically; an error in the block restores all of them.

    Raises ConfigError if a file cannot be read or written.
    """
    before = {file: read_text(file) for file in texts}
    try:
        for file, text in texts.items():
            if text != before[file]:
                replace_file(file, text)
        yield
    except BaseException:
        for file, former in before.items():
            if former is None:
                file.unlink(missing_ok=True)
            elif read_text(file) != former:
                replace_file(file, former)
        raise


def require_own(fleet: FleetConfig, change: str) -> None:
    """Raise ConfigError if the fleet file is part of the installed framework; the error names the wanted change."""
    if is_installed(fleet.source):
        name = fleet.source.stem
        message = (
            "is part of the framework and is not changed: write your own fleet file "
            f"with `include: [{name}]` below `version: 1`, and {change}"
        )
        raise file_error(fleet.source, message)


def with_include(text: str, name: str, include: str) -> str:
    """Return a valid fleet file's text with one more include after all others, otherwise unchanged.

    Raises ConfigError if the layout of the file allows no automatic change.
    """
    root = parse_yaml(text, name).root
    known = root.get("include")
    if known is not None and include in known:
        return text
    lines = _lines_of(text)
    if not known:
        if known is None:
            mark = root.value_marks["version"]
            lines.insert(mark.line, f"include: [{include}]\n")
    else:
        mark = known.marks[-1]
        line = lines[mark.line - 1]
        lead = line[: mark.column - 1]
        if lead.strip() == "-":
            lines.insert(mark.line, f"{lead}{include}\n")
        else:
            end = line.find("]", mark.column - 1)
            lines[mark.line - 1] = f"{line[:end]}, {include}{line[end:]}" if end > 0 else line
    wanted: dict[str, Any] = {**root, "include": [*(root.get("include") or ()), include]}
    return _checked(lines, wanted, name, "include", f"add {include} to the end of its list")


def with_identity(text: str, name: str, identity: str) -> str:
    """Return a valid fleet file's text with an identity, which it has not yet, otherwise unchanged.

    Raises ConfigError if the layout of the file allows no automatic change.
    """
    root = parse_yaml(text, name).root
    lines, network = _lines_of(text), root.get("network")
    if network is None:
        lines.insert(root.value_marks["version"].line, f"network: {{identity: {identity}}}\n")
    elif network:
        _put_first(lines, network, f"identity: {identity}\n", f"identity: {identity}")
    wanted = {**root, "network": {**(network or {}), "identity": identity}}
    return _checked(lines, wanted, name, "network", f"add `identity: {identity}`")


def with_security(text: str, name: str, section: str) -> str:
    """Return a valid fleet file's text with `network.security`, which it has not yet, otherwise unchanged.

    `section` is a section `network` that has only `security`. Raises ConfigError if the file has one, or if its layout
    allows no automatic change.
    """
    root, security = parse_yaml(text, name).root, yaml.safe_load(section)["network"]["security"]
    lines, network = _lines_of(text), root.get("network")
    if network and "security" in network:
        raise file_error(name, "has a section network.security already: omit --write, and change it by hand", "network")
    if "network" not in root:
        lines.append(f"\n{section}")
    elif network:
        block = dedent("".join(section.splitlines(keepends=True)[1:]))
        flow = yaml.safe_dump({"security": security}, default_flow_style=True, sort_keys=False, width=math.inf).strip()
        _put_first(lines, network, block, flow[1:-1])
    wanted = {**root, "network": {**(network or {}), "security": security}}
    advice = "add the section `security` that the command prints without --write"
    return _checked(lines, wanted, name, "network", advice)


def _lines_of(text: str) -> list[str]:
    """Return the lines of a text; the last one ends with a line break too."""
    return f"{text.removesuffix(chr(10))}\n".splitlines(keepends=True)


def _put_first(lines: list[str], section: MarkedDict, block: str, flow: str) -> None:
    """Put an entry before the first key of a section; `flow` is its text where a brace or another key is before it."""
    mark = next(iter(section.key_marks.values()))
    line = lines[mark.line - 1]
    lead, rest = line[: mark.column - 1], line[mark.column - 1 :]
    lines[mark.line - 1] = f"{lead}{flow}, {rest}" if lead.strip() else f"{indent(block, lead)}{line}"


def write_identity(fleet: FleetConfig) -> None:
    """Write a new identity into the file of a fleet without one.

    Several servers may start from one file at the same time: the first one writes, and the others find it. Raises
    ConfigError if the file is part of the framework, its layout allows no automatic change, or it cannot be written.
    """
    require_own(fleet, "add `network: {identity: NAME}`")
    name = str(fleet.source)
    with writing(fleet.source), fleet.source.open(encoding="utf-8") as file:
        _lock(file)
        text = fleet.source.read_text(encoding="utf-8")  # by its name: it may be another file than the locked one
        if not (parse_yaml(text, name).root.get("network") or {}).get("identity"):
            replace_file(fleet.source, with_identity(text, name, new_identity()))


def _lock(file: TextIO) -> None:
    deadline_s = REAL_TIME.now() + _LOCKED_S
    while True:
        try:
            return lock(file)
        except BlockingIOError:
            if REAL_TIME.now() > deadline_s:
                raise
            REAL_TIME.sleep(_LOOK_S)


def _checked(lines: Sequence[str], wanted: Mapping[str, Any], name: str, key: str, advice: str) -> str:
    """Return the text of lines; raise ConfigError unless it has this content."""
    text = "".join(lines)
    try:
        is_so = parse_yaml(text, name).root == wanted
    except ConfigError:
        is_so = False
    if not is_so:
        raise file_error(name, f"cannot be changed automatically: {advice}, then try again", key)
    return text


def read_text(file: Path) -> str | None:
    """Return the text of a file, None without one; raise ConfigError if it cannot be read."""
    with writing(file), suppress(FileNotFoundError):
        return file.read_text(encoding="utf-8")
    return None


def replace_file(file: Path, text: str) -> None:
    """Replace a file atomically, keeping its owner and permissions."""
    trial = file.with_name(f".{file.name}.new")
    try:
        trial.write_text(text, encoding="utf-8")
        if file.exists():
            before = file.stat()
            with suppress(PermissionError):
                os.chown(trial, before.st_uid, before.st_gid)  # a server run by root leaves the file to its owner
            trial.chmod(before.st_mode & 0o777)
        trial.replace(os.path.realpath(file))
    except OSError as error:
        with suppress(OSError):
            trial.unlink(missing_ok=True)
        raise unwritable_error(file, error) from error
