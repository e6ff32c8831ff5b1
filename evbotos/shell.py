"""Running programs of the build machine: with time limits, quiet on success, explicit on failure."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from evbotos.errors import RESUME, BuildError, DiskFullError

_SHOWN_LINES: Final = 12
_TIMEOUT_S: Final = 3600.0


@contextmanager
def _guarded() -> Iterator[Callable[[], None]]:
    """Return what a program must call before it starts; at the end of the `with` block its whole group is killed.

    The programs that make starts would go on without it, and a resumed build would compile in the same folder as they.
    The kernel's signal at a parent's death reaches only the first of them. So a process of the group waits for the end
    of a pipe, which comes when the block ends, and also when the builder is killed.
    """
    alive, end = os.pipe()

    def start() -> None:
        os.setpgid(0, 0)
        # `pkill evbotos` means the builder, whose name the waiting process has too.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGHUP, signal.SIGINT, signal.SIGTERM})
        if os.fork() == 0:
            os.dup2(alive, 0)
            os.closerange(1, os.sysconf("SC_OPEN_MAX"))
            os.read(0, 1)
            os.killpg(0, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

    try:
        yield start
    finally:
        os.close(end)
        os.close(alive)


def run(
    argv: Sequence[str | Path],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    data: bytes | None = None,
    timeout_s: float = _TIMEOUT_S,
) -> str:
    """Run a program and return its output as text; otherwise like `run_binary`."""
    return run_binary(argv, cwd=cwd, env=env, data=data, timeout_s=timeout_s).decode(errors="replace")


def run_binary(
    argv: Sequence[str | Path],
    *,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    data: bytes | None = None,
    timeout_s: float = _TIMEOUT_S,
) -> bytes:
    """Run a program and return its output.

    Args:
        argv: the program and its arguments.
        cwd: its working directory.
        env: additional environment variables; the locale is always C.
        data: its input.
        timeout_s: time limit in real seconds.

    Raises:
        BuildError: it is missing, failed or exceeded the time limit; includes its last lines.
        DiskFullError: it failed because the disk is full.
    """
    name = Path(argv[0]).name
    where = {**os.environ, "LC_ALL": "C", "TZ": "UTC", **(env or {})}
    try:
        with _guarded() as start:
            done = subprocess.run(  # noqa: S603  # programs and arguments are the builder's own
                [str(part) for part in argv],
                cwd=cwd,
                env=where,
                input=data if data is not None else b"",
                capture_output=True,
                preexec_fn=start,
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
            raise DiskFullError(f"{name} failed: the disk is full; {RESUME}")
        raise BuildError("\n".join([f"{name} failed with {done.returncode}", *said.splitlines()[-_SHOWN_LINES:]]))
    return done.stdout
