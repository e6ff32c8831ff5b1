"""The list of revoked certificates of a fleet: names, one a line, in the folder of its keys.

A name on the list has no rights, whatever the fleet file grants it, and its certificate is never believed again: the
name stays revoked. Robots and routers receive the list from `eal keys revoke`, which proves by a certificate with the
name AUTHORITY_CALLER that it has the authority's key; no certificate of a person, a program or a robot can have it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final

from eal_actors.kernel.errors import ConfigError, Problem, file_error, writing
from eal_actors.kernel.strict_model import NAME_PATTERN
from eal_actors.managers.keys.certificates import write_file
from eal_actors.managers.network_model import SecurityConfig

REVOKED: Final = "revoked.txt"
"""Name of the list's file."""


def revoked_names(folder: Path) -> frozenset[str]:
    """Return the revoked names of a folder of keys; none without a list.

    Raises ConfigError if the list cannot be read, or a line is no name: then nobody can know who is revoked.
    """
    file = folder / REVOKED
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return frozenset()
    except (OSError, UnicodeDecodeError) as error:
        raise file_error(file, f"cannot be read: {error}") from error
    problems = [
        Problem(str(file), number, 1, "", f"{line!r} is not the name of a certificate")
        for number, line in enumerate(lines, 1)
        if not re.fullmatch(NAME_PATTERN, line)
    ]
    if problems:
        raise ConfigError(problems)
    return frozenset(lines)


def revoke(folder: Path, names: Iterable[str]) -> frozenset[str]:
    """Add names to the list of a folder, and return all that it has then; ConfigError if that cannot be."""
    known = revoked_names(folder)
    names = known.union(names)
    file = folder / REVOKED
    wrong = sorted(name for name in names if not re.fullmatch(NAME_PATTERN, name))
    if wrong:
        raise file_error(file, f"{wrong[0]!r} cannot be the name of a certificate")
    if names != known:
        with writing(file):
            write_file(file, "".join(f"{name}\n" for name in sorted(names)).encode(), 0o644)
    return names


def require_not_revoked(folder: Path, name: str) -> None:
    """Raise ConfigError if a name is revoked, since a new certificate of that name would have no rights either."""
    if name in revoked_names(folder):
        hint = f"{name} is revoked and stays so, since its old certificate is still valid: choose another name"
        raise file_error(folder / REVOKED, hint)


def without_revoked(security: SecurityConfig) -> SecurityConfig:
    """Return a fleet's security without the grants of revoked certificates; ConfigError if the list cannot be read."""
    revoked = revoked_names(security.keys)
    return replace(
        security,
        grants=tuple(grant for grant in security.grants if grant.name not in revoked),
        routers=tuple(name for name in security.routers if name not in revoked),
    )
