"""The program `eal`, also as `python -m eal_actors`."""

from __future__ import annotations

import sys
from importlib import import_module


def main() -> None:
    """Run the program and exit."""
    try:
        import_module("eal_actors.cli").main()  # loads for a second, several on a small board: Ctrl-C counts from here
    except KeyboardInterrupt:
        sys.exit(130)  # the code of eal_actors.cli.exit_codes, which may not be loaded yet


if __name__ == "__main__":
    main()
