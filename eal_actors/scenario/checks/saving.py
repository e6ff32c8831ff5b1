"""What can be wrong with what a call is given and with the file that keeps its answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from pathlib import PurePosixPath
from typing import Any

from eal_actors.device.info import ResourceInfo
from eal_actors.kernel.yaml_tree import YamlPath
from eal_actors.scenario.checks.arguments import answer_info
from eal_actors.scenario.checks.names import Loop
from eal_actors.scenario.checks.units import call_unit_problem
from eal_actors.scenario.files import APPENDED, answer_problem, suffix_problem
from eal_actors.scenario.model import AnswerStep, CallStep, ScenarioFile


def misfits(
    step: CallStep, file: ScenarioFile, info: ResourceInfo, given: Mapping[str, Any]
) -> Iterator[tuple[YamlPath, str]]:
    """Yield what does not go together in a call that is right by itself: units, and the answer and its file.

    Args:
        step: the call.
        file: the scenario that it belongs to.
        info: the resource that takes it.
        given: what it is given, worked out and found to fit.
    """
    if (wrong := call_unit_problem(step, file, info, given)) is not None:
        yield wrong
    if isinstance(step, AnswerStep) and step.save is not None:
        answer = answer_info(step.kind, info, given)
        if answer is not None and (problem := answer_problem(step.save, answer)) is not None:
            yield ("save",), problem


def save_problems(name: str, varying: AbstractSet[str], around: Sequence[Loop]) -> list[str]:
    """Return what is wrong with a name as the scenario gives it.

    Args:
        name: the name.
        varying: the variables in it that may change during the run.
        around: the loops around the step, from the outermost.
    """
    problem = suffix_problem(name)
    if problem is not None:
        return [problem]
    if PurePosixPath(name).suffix in APPENDED:
        return []
    loops = {loop.name for loop in around}
    if not varying <= loops:  # with what is saved during the run, no name need come twice
        return []
    return _overwrites(varying, around)


def _overwrites(used: AbstractSet[str], around: Sequence[Loop]) -> list[str]:
    """Return which loops around a step have a file of its overwritten."""
    problems: dict[str, None] = {}
    for number, loop in enumerate(around):
        if loop.passes == 1:
            continue
        if loop.name not in used:
            problems[f"each pass of the loop around it overwrites the file: its name lacks ${{{loop.name}}}"] = None
        elif any(inner.name == loop.name for inner in around[number + 1 :]):
            message = "each pass of the outer 'repeat' overwrites the files of the one before: "
            hidden = f"${{{loop.name}}} is that of the inner 'repeat' here; write one of them as a 'for'"
            problems[message + hidden] = None
    return list(problems)
