"""Policy: a file of rules for plans that run without a person's approval. A rule must allow the whole of a plan.

Every call is judged with every value that it can have. A call whose values are known only during the run is not
allowed, nor is a step kind that the rule does not name, such as `go_to` or `python`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field, PositiveFloat
from typing_extensions import override

from eal_actors.device.data import EALData
from eal_actors.device.info import ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import ConfigError, EALError, Problem
from eal_actors.kernel.strict_model import StrictModel, Version1, model_of
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.twins import simulated
from eal_actors.scenario import Plan
from eal_actors.scenario.engine.plan import robot_facts
from eal_actors.scenario.language.binding import Binding
from eal_actors.scenario.language.robot_check import CheckedCall, RobotCheck, RobotScope
from eal_actors.scenario.language.values import Text

_READING: Final = frozenset({"get_status", "get_value", "read_comm", "get_config", "halt"})
"""Methods that move nothing, and the halt."""
_CONTROL: Final = frozenset(
    {
        *("barrier", "expect", "for", "if", "let", "log", "on", "parallel", "repeat", "sequence", "signal"),
        *("wait_for", "wait_s", "wait_until", "while"),
    }
)
"""Step kinds that command no robot by themselves."""
_CALLS: Final = frozenset({*_READING, "send_req", "set_value", "send_cmd"})

Span = Annotated[tuple[float, float], Field(strict=False)]


class PolicyRule(StrictModel):
    """Plans that may run without a person."""

    name: Text
    """The name in the audit log."""
    robots: Annotated[tuple[Text, ...], Field(strict=False, min_length=1)]
    """Names or patterns such as `evbot2-*`; every robot of the plan must fit one of them."""
    commands: dict[str, dict[str, Span | None]] = Field(default={})
    """For each resource its commands without their arguments, such as `f`, each with the range of its argument; with
    an empty range, any."""
    values: dict[str, Span] = Field(default={})
    """For each resource that `set_value` may set, the range of its numbers."""
    steps: Annotated[tuple[Text, ...], Field(strict=False)] = ()
    """Step kinds that move robots otherwise, such as `go_to`."""
    max_duration_s: PositiveFloat
    """Of the rehearsal, and of the run, which is aborted then; in seconds of the fleet's clock."""
    only_in_simulation: bool = True
    """Every robot of the plan must be a simulated one of this process."""


class PolicyFile(StrictModel):
    """A file of rules."""

    version: Version1
    rules: Annotated[tuple[PolicyRule, ...], Field(strict=False)]


class Policy:
    """The rules of a file. Thread: any."""

    def __init__(self, rules: Sequence[PolicyRule] = ()) -> None:
        self._rules = rules

    def __bool__(self) -> bool:
        return bool(self._rules)

    def judge(self, plan: Plan, fleet: Fleet, duration_s: float) -> tuple[PolicyRule | None, list[Problem]]:
        """Return the first rule that allows a plan with its longest rehearsal; None with why each rule does not."""
        why: dict[Problem, None] = {}
        for rule in self._rules:
            problems = _against(rule, plan, fleet, duration_s)
            if not problems:
                return rule, []
            why.update(dict.fromkeys(problems))
        return None, list(why)


def load_policy(path: Path) -> Policy:
    """Read a policy file. Raises ConfigError with every problem of the file."""
    return Policy(model_of(PolicyFile, load_yaml(path)).rules)


def _against(rule: PolicyRule, plan: Plan, fleet: Fleet, duration_s: float) -> list[Problem]:
    """Return why a rule does not allow a plan."""
    scenario = plan.scenario
    words = f"not allowed by rule '{rule.name}'"
    if general := _general_reason(rule, plan, fleet, duration_s):
        return [scenario.problem(("steps",), f"{words}: {general}")]
    problems = [
        owner.problem((*path, step.kind), f"{words}: a step '{step.kind}'", key=True)
        for owner, path, _, step in scenario.walk()
        if step.kind not in _CONTROL | _CALLS | set(rule.steps)
    ]
    check = _PolicyCheck(rule, words, plan, fleet)
    return problems or check.problems_of(scenario, fleet.config.seed)


def _general_reason(rule: PolicyRule, plan: Plan, fleet: Fleet, duration_s: float) -> str | None:
    foreign = [name for name in plan.robots if not any(fnmatchcase(name, pattern) for pattern in rule.robots)]
    if foreign:
        return f"robot {foreign[0]}"
    if plan.lost:
        return f"{next(iter(plan.lost))} did not start"
    if duration_s > rule.max_duration_s:
        return f"it takes {duration_s:.1f} s, more than {rule.max_duration_s:g} s"
    if rule.only_in_simulation and (real := _real_robots(plan, fleet)):
        return f"{real[0]} is not simulated in this process"
    return None


def _real_robots(plan: Plan, fleet: Fleet) -> list[str]:
    """Return the robots of a plan that are served elsewhere, or have a plugin that is not simulated."""
    robots = fleet.config.robots
    try:
        twins = simulated(fleet.config, plan.robots)
    except ConfigError:
        return list(plan.robots)
    return [
        name
        for name in plan.robots
        if robots[name].address is not None or name in twins.replaced or name in twins.left_out
    ]


class _PolicyCheck(RobotCheck):
    """The check of a scenario on its robots, which also compares every call with a rule."""

    def __init__(self, rule: PolicyRule, words: str, plan: Plan, fleet: Fleet) -> None:
        facts = {name: robot_facts(fleet[name]) for name in plan.robots}
        super().__init__(facts, Binding(plan.roles, plan.spares), fleet.config.world)
        self._rule = rule
        self._words = words

    @override
    def call(self, call: CheckedCall, robots: Sequence[str], here: RobotScope) -> ResourceInfo | None:
        info = super().call(call, robots, here)
        if info is not None and (reason := _call_reason(self._rule, call.method, info, call.given)) is not None:
            self.report(here, call.arguments_at.path, f"{self._words}: {reason}", robots, call.arguments_at.inside)
        return info


def _call_reason(rule: PolicyRule, method: str, info: ResourceInfo, given: Mapping[str, Any] | None) -> str | None:
    """Return why a rule does not allow a call; None if it does."""
    if method in _READING:
        return None
    if given is None:
        return f"{info.name} {method} has a value that is known only during the run"
    if method == "send_req" and info.is_reading(str(given["req"])):
        return None
    if method == "set_value" and info.name in rule.values:
        return _outside(f"{info.name} set_value", given["value"], rule.values[info.name])
    if method != "send_cmd" or info.name not in rule.commands:
        return f"{info.name} {method}"
    try:
        command, argument = info.parse_command(
            str(given["cmd"]), EALData.of(given["data"]) if given.get("data") is not None else None
        )
    except EALError as error:
        return error.message
    name, allowed = command.prefix or command.name, rule.commands[info.name]
    if name not in allowed:
        return f"{info.name} {name}"
    span = allowed[name]
    return _outside(f"{info.name} {name}", argument.value if argument is not None else 0, span) if span else None


def _outside(what: str, value: Any, span: Span) -> str | None:
    numbers = value if isinstance(value, list | tuple) else value.tolist() if hasattr(value, "tolist") else [value]
    flat = numbers if isinstance(numbers, list | tuple) else [numbers]
    low, high = span
    for number in flat:
        if not isinstance(number, int | float):
            return f"{what}: {number!r} is no number"
        if not low <= number <= high:
            return f"{what} {number:g} is not within {low:g} and {high:g}"
    return None
