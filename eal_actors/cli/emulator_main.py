"""Runs a plugin's emulator as a program, and ends it when its stdin closes.

    python -P emulator_main.py PLUGIN MODULE NAME=FOLDER ... -- [ARGUMENT ...]

The folders are those of the plugin and of the plugins that it uses. Stdin closes however the parent process ends, so
the emulator does not outlive it. This module imports nothing else of the framework, so that it starts at once.
"""

from __future__ import annotations

import os
import runpy
import signal
import sys
import threading
from types import ModuleType

_PACKAGE = "eal_plugins"  # as in managers/plugins.py: the package that contains every plugin's package


def _end_with_stdin() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _make_package(name: str, path: list[str]) -> None:
    package = sys.modules[name] = ModuleType(name)
    package.__path__ = path


def main() -> None:
    """Run the module with its own arguments."""
    plugin, module, *rest = sys.argv[1:]
    end = rest.index("--")
    _make_package(_PACKAGE, [])
    for name, _, folder in (package.partition("=") for package in rest[:end]):
        _make_package(f"{_PACKAGE}.{name}", [folder])
    sys.argv = [module, *rest[end + 1 :]]
    threading.Thread(target=_end_with_stdin, name="end with stdin", daemon=True).start()
    try:
        runpy.run_module(f"{_PACKAGE}.{plugin}.{module}", run_name="__main__", alter_sys=True)
    except BrokenPipeError:  # the parent process has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
