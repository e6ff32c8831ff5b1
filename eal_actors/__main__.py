"""The program `eal`, also as `python -m eal_actors`."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from importlib import import_module
from typing import Final

_INTERRUPTED: Final = 130
"""The exit code of eal_actors.cli.exit_codes, which may not be loaded yet."""


def main() -> None:
    """Run the program and exit."""
    # At its end the interpreter restores the default action, which would kill the process with another exit code.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)  # runs last
    gc.disable()  # loading makes much and drops nothing; enabled when the command is loaded
    # Loading takes seconds on a small board. An exception in the midst of an import would come out as any other one.
    if signal.getsignal(signal.SIGINT) != signal.SIG_IGN:
        signal.signal(signal.SIGINT, _end)
    try:
        import_module("eal_actors.cli").main()
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, _end)


def _end(*_: object) -> None:
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    main()
