"""Start the robot's server as quickly as a slow board can.

It gives up the rights of root before it imports the framework. It skips modules that only terminals need, defers
optional imports until first use, and disables garbage collection during imports: on a Cortex-A8 or in an emulator,
each of these costs seconds.
"""

from __future__ import annotations

import gc
import os
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

_CONSOLE: Final = Path("/dev/console")
_IN_CASE: Final = ("asyncio", "zipfile")


def load_when_used(name: str) -> None:
    """Defer the import of a module until its first use."""
    late = ModuleType(name)

    def first_use(attribute: str) -> Any:
        if sys.modules.get(name) is late:
            del sys.modules[name]
        return getattr(import_module(name), attribute)

    late.__getattr__ = first_use  # type: ignore[method-assign]  # see PEP 562
    sys.modules[name] = late


def main() -> None:
    """Load and run the server."""
    gc.disable()
    sys.path[:] = filter(os.path.isdir, sys.path)
    try:
        own = import_module("robot_user").become_robot()
    except OSError as error:  # such as of a partition or a stick that cannot be read
        _CONSOLE.write_text(f"evbotos: the robot does not start: {error}\n")
        raise
    sys.modules["rich"] = None  # type: ignore[assignment]  # marks it as not installed; structlog works without it
    for name in _IN_CASE:
        load_when_used(name)
    server = import_module("serve_robot")
    gc.freeze()
    gc.enable()
    server.main(own)


if __name__ == "__main__":
    main()
