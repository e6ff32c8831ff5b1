"""Runs a plugin's emulator as a program, and ends it when its stdin closes.

    python -P emulator_main.py PLUGIN MODULE NAME=FOLDER ... -- [ARGUMENT ...]
    python -P emulator_main.py PLUGIN MODULE NAME=FOLDER ... --wire pty|tcp|udp SETTINGS

The folders are those of the plugin and of the plugins that it uses. The second form serves a module that is no program,
but has `emulate(settings, now_s)`, on the wires of `eal plugin check`; it prints the address. Stdin closes however the
parent process ends, so the emulator does not outlive it. The first form imports nothing else of the framework, so that
it starts at once.
"""

from __future__ import annotations

import importlib
import json
import os
import runpy
import signal
import sys
import threading
from types import ModuleType

_PACKAGE = "eal_plugins"  # as in device/plugin_context.py: the package that contains every plugin's package


def _end_with_stdin() -> None:
    while os.read(sys.stdin.fileno(), 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


def _make_package(name: str, path: list[str]) -> None:
    package = sys.modules[name] = ModuleType(name)
    package.__path__ = path


def main() -> None:
    """Run the module with its own arguments, or serve its emulator."""
    plugin, module, *rest = sys.argv[1:]
    end = next(place for place, word in enumerate(rest) if word in ("--", "--wire"))
    _make_package(_PACKAGE, [])
    for name, _, folder in (package.partition("=") for package in rest[:end]):
        _make_package(f"{_PACKAGE}.{name}", [folder])
    sys.argv = [module, *rest[end + 1 :]]
    threading.Thread(target=_end_with_stdin, name="end with stdin", daemon=True).start()
    if rest[end] == "--wire":
        from eal_actors.device.serving_emulators import serve_emulator

        kind, settings = rest[end + 1 :]
        emulate = importlib.import_module(f"{_PACKAGE}.{plugin}.{module}").emulate
        serve_emulator(kind, lambda now_s: (emulate(json.loads(settings), now_s), None))
        return
    try:
        runpy.run_module(f"{_PACKAGE}.{plugin}.{module}", run_name="__main__", alter_sys=True)
    except BrokenPipeError:  # the parent process has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


if __name__ == "__main__":
    main()
