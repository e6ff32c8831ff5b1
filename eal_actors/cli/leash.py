"""Runs a module as a program, and ends it when nobody holds the other end of its stdin any more.

    python -P leash.py MODULE [ARGUMENT ...]

So it does not outlive whoever started it, however that one ends; what it says then may have no reader any more. It
imports nothing else, so that it starts at once.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading


def _end_with_stdin() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def main() -> None:
    """Run the module, which sees its own arguments."""
    sys.argv = sys.argv[1:]
    threading.Thread(target=_end_with_stdin, name="leash", daemon=True).start()
    try:
        runpy.run_module(sys.argv[0], run_name="__main__", alter_sys=True)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
