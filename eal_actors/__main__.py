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
    try:
        import_module("eal_actors.cli").main()  # loads for a while, seconds on a small board: Ctrl-C counts from here
    except KeyboardInterrupt:
        sys.exit(_INTERRUPTED)
    finally:
        signal.signal(signal.SIGINT, lambda *_: os._exit(_INTERRUPTED))


if __name__ == "__main__":
    main()
