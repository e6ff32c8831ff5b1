"""Start the robot's server as quickly as a slow board can.

What only terminals need is not loaded, what others load only in case is loaded when it is used, and what is loaded is
not looked through for garbage: on a Cortex-A8, and in an emulator, each costs seconds.
"""

from __future__ import annotations

import gc
import os
import sys
from importlib import import_module
from types import ModuleType
from typing import Any, Final

_IN_CASE: Final = ("asyncio", "zipfile")


def load_when_used(name: str) -> None:
    """Have a module loaded when something of it is used first, and not where it is imported."""
    late = ModuleType(name)

    def first_use(attribute: str) -> Any:
        if sys.modules.get(name) is late:
            del sys.modules[name]
        return getattr(import_module(name), attribute)

    late.__getattr__ = first_use  # type: ignore[method-assign]  # as PEP 562 has it
    sys.modules[name] = late


def main() -> None:
    """Load the server, and serve."""
    gc.disable()
    sys.path[:] = filter(os.path.isdir, sys.path)
    sys.modules["rich"] = None  # type: ignore[assignment]  # to Python: not installed; structlog then does without
    for name in _IN_CASE:
        load_when_used(name)
    server = import_module("serve_robot")
    gc.freeze()
    gc.enable()
    server.main()


if __name__ == "__main__":
    main()
