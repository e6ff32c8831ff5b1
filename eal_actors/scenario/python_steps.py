"""Steps that are Python functions: how they are found, and what they are given."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Final

from eal_actors.actors.handles import RobotHandle
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import Problem, error_text
from eal_actors.kernel.strict_model import did_you_mean
from eal_actors.kernel.yaml_tree import YamlPath, format_path
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.scenario.model import AnyStep, PythonStep, inner_steps
from eal_actors.scenario.scenario import Scenario

GROUP: Final = "eal_actors.steps"
"""The group of entry points that hold steps."""


@dataclass(frozen=True, slots=True)
class StepContext:
    """What a Python step is given beside its own arguments.

    Attributes:
        robots: the robots it may use, by name: the one of the `on` around it, or all that take part outside of one.
        robot: the robot of the `on` around it, or None.
        directory: the run's folder, for what the step leaves behind; None if nothing is kept. Files of a robot go
            into its folder there, `directory / robot`.
        clock: the fleet's clock.
        variables: the scenario's variables as they stand, by name; changes reach nobody.
        seed: where all randomness of the fleet starts from.
        is_cancelled: returns whether nobody waits for the step any more: its deadline is past, or the run was stopped.
            A step that takes long asks every now and then, and returns.
        log: tells those who watch the run a line of text. Thread: the step's own; does not block.
    """

    robots: Mapping[str, RobotHandle]
    robot: str | None
    directory: Path | None
    clock: Clock
    variables: Mapping[str, Any]
    seed: int
    is_cancelled: Callable[[], bool]
    log: Callable[[str], None]


StepFunction = Callable[..., Any]
"""Called as `step(context, **with)`; what it returns is the step's value."""


@dataclass(frozen=True, slots=True)
class PythonSteps:
    """The functions of a scenario's Python steps.

    Attributes:
        functions: by the name that the scenario gives them.
        problems: what is wrong with them.
    """

    functions: Mapping[str, StepFunction] = field(default_factory=dict)
    problems: tuple[Problem, ...] = ()

    @classmethod
    def of(cls, scenario: Scenario, fleet: FleetConfig) -> PythonSteps:
        """Find the functions that a scenario and its parts name, and hold their arguments against them.

        This runs the code of the modules that hold them.
        """
        functions: dict[str, StepFunction] = {}
        wrong: dict[str, str] = {}
        problems: dict[Problem, None] = {}
        for place, path, step in _python_steps(scenario):
            if step.python not in functions and step.python not in wrong:
                found = _find(step.python, fleet)
                if isinstance(found, str):
                    wrong[step.python] = found
                else:
                    functions[step.python] = found
            message = wrong.get(step.python) or _misfit(functions[step.python], step)
            if message is not None:
                problems[place.problem((*path, "python"), message)] = None
        return cls(functions, tuple(problems))


def _python_steps(scenario: Scenario) -> Iterator[tuple[Scenario, YamlPath, PythonStep]]:
    waiting: list[tuple[Scenario, YamlPath, tuple[AnyStep, ...]]] = [
        (scenario, ("finally",), scenario.file.finally_),
        (scenario, ("steps",), scenario.file.steps),
    ]
    while waiting:
        place, path, steps = waiting.pop()
        for index, step in enumerate(steps):
            here = (*path, index)
            if isinstance(step, PythonStep):
                yield place, here, step
            part = place.parts.get(format_path(here)) if step.kind == "scenario" else None
            if part is not None:
                waiting += [(part, ("finally",), part.file.finally_), (part, ("steps",), part.file.steps)]
            waiting += [(place, (*here, *keys), inner) for keys, inner in inner_steps(step)]


def _find(name: str, fleet: FleetConfig) -> StepFunction | str:
    """Return a function, or what is wrong with its name."""
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
    except Exception as error:  # noqa: BLE001  # the module is the user's
        return f"'{name}' cannot be loaded: {error_text(error)}"
    return found if callable(found) else f"'{name}' is no function"


def _module(name: str, folder: Path) -> Any:
    """Import a module: the one beside the fleet file if there is one, else by the usual ways."""
    file = folder / f"{name}.py"
    if "." in name or not file.is_file():
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"{file} is no module")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _misfit(function: StepFunction, step: PythonStep) -> str | None:
    """Return why a function does not take the arguments of a step, or None."""
    try:
        inspect.signature(function).bind(None, **dict.fromkeys(step.with_))
    except TypeError as error:
        return f"'{step.python}' does not take these arguments: {error}"
    except ValueError:  # a function that does not tell
        return None
    return None
