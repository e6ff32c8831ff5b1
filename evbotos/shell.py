"""Running the build machine's programs: bounded, quiet, and loud when they fail."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from evbotos.errors import BuildError, DiskFullError

_SHOWN_LINES: Final = 12
_TIMEOUT_S: Final = 3600.0
_SET_PARENT_DEATH_SIGNAL: Final = 1
"""`PR_SET_PDEATHSIG` of Linux's prctl."""
_LIBC: Final = ctypes.CDLL(None)


def _die_with_parent() -> None:
    """Have the kernel kill this process with the builder, so that a killed build leaves nobody writing."""
    _LIBC.prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGKILL)


def run(
    argv: Sequence[str | Path],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    data: bytes | None = None,
    timeout_s: float = _TIMEOUT_S,
) -> str:
    """Run a program to its end and return its output as text; the rest as for `run_binary`."""
    return run_binary(argv, cwd=cwd, env=env, data=data, timeout_s=timeout_s).decode(errors="replace")


def run_binary(
    argv: Sequence[str | Path],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    data: bytes | None = None,
    timeout_s: float = _TIMEOUT_S,
) -> bytes:
    """Run a program to its end and return its output.

    Args:
        argv: the program and its arguments.
        cwd: where it runs.
        env: what is added to the environment; the locale is always C.
        data: its input.
        timeout_s: real seconds after which it is killed.

    Raises:
        BuildError: it is not there, failed or took too long; with the last lines that it said.
        DiskFullError: it failed because there was no room.
    """
    name = Path(argv[0]).name
    where = {**os.environ, "LC_ALL": "C", "TZ": "UTC", **(env or {})}
    try:
        done = subprocess.run(  # noqa: S603  # programs and arguments are the builder's own
            [str(part) for part in argv],
            cwd=cwd,
            env=where,
            input=data if data is not None else b"",
            capture_output=True,
            preexec_fn=_die_with_parent,
            timeout=timeout_s,
            check=False,
        )
    except FileNotFoundError:
        raise BuildError(f"{name} is not installed") from None
    except subprocess.TimeoutExpired:
        raise BuildError(f"{name} was killed: it took longer than {timeout_s:g} s") from None
    if done.returncode:
        said = (done.stderr or done.stdout).decode(errors="replace")
        if os.strerror(errno.ENOSPC) in said:
            raise DiskFullError(f"{name} finds the disk full; make room, and build again: finished steps are kept")
        raise BuildError("\n".join([f"{name} failed with {done.returncode}", *said.splitlines()[-_SHOWN_LINES:]]))
    return done.stdout
