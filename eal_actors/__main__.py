"""The program `eal`, also as `python -m eal_actors`; interrupted while it still loads, it ends as it does later."""

from __future__ import annotations

import sys


def main() -> None:
    """Run the program and exit."""
    try:
        from eal_actors.cli import main as run  # which takes a second, and several on a small board

        run()
    except KeyboardInterrupt:
        sys.exit(130)  # as in eal_actors.cli.exit_codes, which may not be there yet


if __name__ == "__main__":
    main()
