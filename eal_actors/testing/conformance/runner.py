"""The list of checks, and how they are run."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal

from eal_actors.kernel.errors import ConfigError, EALError
from eal_actors.testing.conformance import answering, describing, living, moving, wiring
from eal_actors.testing.conformance.bench import Bench, BlockedActor, Findings


@dataclass(frozen=True, slots=True)
class Check:
    """One check.

    Attributes:
        run: looks at the plugin and notes what it finds; its docstring says what must hold.
        nothing: why there may be nothing to look at, for the record of a check that was skipped.
    """

    run: Callable[[Bench, Findings], None]
    nothing: str = ""

    @property
    def name(self) -> str:
        """The check's name, such as `comes up`."""
        return self.run.__name__.replace("_", " ")

    @property
    def description(self) -> str:
        """What must hold."""
        return (self.run.__doc__ or "").strip()


@dataclass(frozen=True, slots=True)
class CheckResult:
    """What came of one check.

    Attributes:
        check: the check.
        outcome: `ok`, `failed` or `skipped`.
        problems: what is wrong, or why it was skipped, as a whole or for some resources.
        blocked: the resource that one of its commands blocked, which ended the check.
    """

    check: Check
    outcome: Literal["ok", "failed", "skipped"]
    problems: tuple[str, ...] = ()
    blocked: str | None = None


CHECKS: Final = (
    Check(describing.comes_up),
    Check(describing.describes_itself),
    Check(describing.survives_json),
    Check(answering.says_what_it_lacks, "every resource supports all nine methods"),
    Check(answering.answers, "nothing can be asked without an argument"),
    Check(answering.keeps_configuration, "no configuration key is writable"),
    Check(answering.refuses_unknown_names, "no commands, requests or configuration keys are listed"),
    Check(moving.carries_out_commands, "no argument can be made up for any command"),
    Check(answering.refuses_bad_arguments, "no argument has a type"),
    Check(moving.can_be_halted, "it has no actuator"),
    Check(moving.stops_what_runs, "no command of an actuator takes time"),
    Check(living.shares_nothing, "two of it do not come up side by side"),
    Check(wiring.keeps_calls_apart, "nothing can be asked without an argument"),
    Check(wiring.waits_for_its_device, "no emulator stands in for a device that could be away"),
    Check(wiring.bears_unplugging, "no emulator stands in for a device that could be pulled out"),
    Check(living.leaves_no_thread),
    Check(wiring.frees_its_port, "this system does not tell what is open"),
    Check(living.comes_back),
)
"""Every check, in the order in which an author wants to hear of them."""


def run_check(check: Check, bench: Bench) -> CheckResult:
    """Run one check in a fleet of its own.

    Raises:
        ConfigError: the plugin's manifest or the settings are wrong.

    Thread: blocks the caller; what can move will move, for a moment.
    """
    findings = Findings()
    try:
        check.run(bench, findings)
    except ConfigError:
        raise
    except BlockedActor as blocked:
        return CheckResult(check, "failed", (str(blocked),), blocked.resource)
    except EALError as error:
        findings.problems.append(str(error))
    if findings.problems:
        return CheckResult(check, "failed", tuple(dict.fromkeys(findings.problems)))
    if not findings.tried:
        return CheckResult(check, "skipped", (check.nothing,))
    return CheckResult(check, "ok")


def run_checks(bench: Bench) -> Iterator[CheckResult]:
    """Run every check, and yield each result as it is there; see run_check.

    A plugin that does not come up fails the first check, and the others are skipped. So are all further checks of a
    resource that one of its commands blocked.
    """
    first = run_check(CHECKS[0], bench)
    yield first
    for check in CHECKS[1:]:
        if first.outcome != "ok":
            yield CheckResult(check, "skipped", ("it did not come up",))
            continue
        result = _run_on_the_rest(check, bench)
        yield result
        if result.blocked is not None:
            bench = replace(bench, left_out=bench.left_out | {result.blocked})


def _run_on_the_rest(check: Check, bench: Bench) -> CheckResult:
    """Run a check on what is not blocked, and tell of what is."""
    if not bench.left_out:
        return run_check(check, bench)
    reason = f"not of {', '.join(sorted(bench.left_out))}, which a command blocked"
    resources = bench.manifest().file.resources  # none where only the settings tell them
    if resources and bench.left_out.issuperset(resources):
        return CheckResult(check, "skipped", (reason,))
    result = run_check(check, bench)
    return result if result.outcome == "failed" else replace(result, problems=(*result.problems, reason))
