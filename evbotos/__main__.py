"""The program `evbotos`, also as `python -m evbotos`."""

from __future__ import annotations

import sys
from typing import Final

_OF_THE_EXTRA: Final = ("cryptography", "cyclonedx", "packaging")


def main() -> None:
    """Run the program and exit; without its extra, name the module and how to install it."""
    try:
        from evbotos.cli import main as run
    except ModuleNotFoundError as error:
        module = (error.name or "").partition(".")[0]
        if module not in _OF_THE_EXTRA:
            raise
        sys.exit(f"Error: evbotos needs {module}: pip install 'eal-actors[evbotos]'")
    run()


if __name__ == "__main__":
    main()
