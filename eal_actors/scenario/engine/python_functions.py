"""The functions of a scenario's Python steps: found before the run, and joined after it."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final

from eal_actors.kernel.clock import REAL_TIME, Clock
from eal_actors.kernel.errors import error_text
from eal_actors.kernel.log import get_logger
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.fleet_model import FleetConfig

GROUP: Final = "eal_actors.steps"
"""The group of entry points that hold functions for steps."""
_JOIN_S: Final = 0.5
"""Real seconds that functions have to return after the run."""

StepFunction = Callable[..., Any]
"""Called as `step(context, **with)`; its result is the step's value. With an attribute `safe_to_repeat = True`, a
resumed run calls it again if it was interrupted."""


def find_function(
    name: str, arguments: Iterable[str], fleet: FleetConfig, functions: dict[str, StepFunction]
) -> str | None:
    """Add a function to those found so far, and check its arguments; return the problem with them, or None.

    It is an entry point, or a `module:function` that the fleet file allows. Its module is imported, so its code runs.
    """
    if name not in functions:
        found = _find(name, fleet)
        if isinstance(found, str):
            return found
        functions[name] = found
    try:
        inspect.signature(functions[name]).bind(None, **dict.fromkeys(arguments))
    except TypeError as error:
        return f"'{name}' does not take these arguments: {error}"
    except ValueError:  # a function without a signature
        return None
    return None


def _find(name: str, fleet: FleetConfig) -> StepFunction | str:
    """Return a function, or the problem with its name."""
    known = {point.name: point for point in entry_points(group=GROUP)}
    try:
        if ":" not in name:
            if name not in known:
                hint = did_you_mean(name, [*known, *fleet.python_steps])
                return f"unknown Python step '{name}'{hint}; one of your own is written module:function"
            found = known[name].load()
        else:
            if name not in fleet.python_steps:
                return f"'{name}' is not among the python_steps that fleet '{fleet.name}' allows; add it there"
            module, _, function = name.partition(":")
            found = getattr(_module(module, fleet.source.parent), function)
    except Exception as error:  # noqa: BLE001  # importing user code may raise anything
        return f"'{name}' cannot be loaded: {error_text(error)}"
    return found if callable(found) else f"'{name}' is no function"


def _module(name: str, folder: Path) -> Any:
    """Import a module: the one beside the fleet file if there is one, otherwise an installed one."""
    file = folder / f"{name}.py"
    if "." in name or not file.is_file():
        return importlib.import_module(name)
    key = f"{name} of {file.resolve()} ({file.stat().st_mtime_ns})"  # its own: another fleet may have one of that name
    if key in sys.modules:
        return sys.modules[key]
    spec = importlib.util.spec_from_file_location(key, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no module")
    module = sys.modules[key] = importlib.util.module_from_spec(spec)  # where dataclasses look for it
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[key]
        raise
    return module


def join_threads(threads: Sequence[threading.Thread], clock: Clock) -> bool:
    """Wait a little for the functions of a run that is over; log those that do not return.

    Return whether there was one: it may have sent a command after the robots were halted.
    """
    alive = [thread for thread in threads if thread.is_alive()]
    if not alive:
        return False
    end_s = REAL_TIME.now() + _JOIN_S
    with clock.outside():
        for thread in alive:
            thread.join(max(0.0, end_s - REAL_TIME.now()))
    for thread in alive:
        if thread.is_alive():
            get_logger(thread=thread.name).error("the function did not return after the run; its thread keeps running")
    return True
