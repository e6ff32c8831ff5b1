"""List of the checks, and functions that run them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Final, Literal

from eal_actors.kernel.errors import ConfigError, EALError
from eal_actors.testing.conformance import (
    call_checks,
    connection_checks,
    description_checks,
    lifecycle_checks,
    motion_checks,
    pose_checks,
)
from eal_actors.testing.conformance.bench import Bench, BlockedActor, Findings


@dataclass(frozen=True, slots=True)
class Check:
    """A check, whose function's docstring states the requirement; `nothing` is why there may be nothing to check."""

    run: Callable[[Bench, Findings], None]
    nothing: str = ""

    @property
    def name(self) -> str:
        """The check's name, such as `starts`."""
        return self.run.__name__.replace("_", " ")

    @property
    def description(self) -> str:
        """The requirement."""
        return (self.run.__doc__ or "").strip()


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of a check: the problems, or why the check, or part of it, was skipped.

    `blocked` is the resource whose actor a command blocked, which ended the check.
    """

    check: Check
    outcome: Literal["ok", "failed", "skipped"]
    problems: tuple[str, ...] = ()
    blocked: str | None = None


CHECKS: Final = (
    Check(description_checks.starts),
    Check(description_checks.describes_itself),
    Check(description_checks.survives_json),
    Check(call_checks.reports_unsupported_methods, "every resource supports all nine methods"),
    Check(call_checks.answers_at_once, "no resource has a value or a status"),
    Check(call_checks.answers, "no call works without an argument"),
    Check(call_checks.keeps_configuration, "no configuration key is writable"),
    Check(call_checks.refuses_unknown_names, "no commands, requests or configuration keys are listed"),
    Check(motion_checks.runs_commands, "no command has an argument that can be chosen"),
    Check(call_checks.refuses_bad_arguments, "no argument has a type"),
    Check(motion_checks.can_be_halted, "it has no actuator"),
    Check(motion_checks.stops_running_commands, "no command of an actuator takes time"),
    Check(motion_checks.comes_to_rest, "no resource has a stop command and a status"),
    Check(pose_checks.estimates_its_pose, "it has no Pose that estimates"),
    Check(lifecycle_checks.shares_no_state, "two instances cannot run side by side"),
    Check(connection_checks.separates_concurrent_calls, "no call works without an argument"),
    Check(connection_checks.waits_for_its_device, "there is no emulated device to be absent"),
    Check(connection_checks.survives_unplugging, "there is no emulated device to unplug"),
    Check(lifecycle_checks.leaves_no_thread),
    Check(lifecycle_checks.cleans_up),
    Check(connection_checks.releases_its_ports, "this system does not list open files"),
    Check(lifecycle_checks.reconnects),
)
"""Every check, from basic to specific."""


def run_check(check: Check, bench: Bench) -> CheckResult:
    """Run one check in its own fleet; raise ConfigError if the plugin's manifest or the settings are wrong.

    Thread: blocks the caller; actuators move for a moment.
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
    """Run every check, and yield each result at once; raises like `run_check`.

    If the plugin does not start, the first check fails and the others are skipped. Resources with a blocked actor are
    skipped in all further checks.
    """
    first = run_check(CHECKS[0], bench)
    yield first
    for check in CHECKS[1:]:
        if first.outcome != "ok":
            yield CheckResult(check, "skipped", ("the plugin did not start",))
            continue
        result = _run_on_unblocked(check, bench)
        yield result
        if result.blocked is not None:
            bench = replace(bench, left_out=bench.left_out | {result.blocked})


def _run_on_unblocked(check: Check, bench: Bench) -> CheckResult:
    """Run a check without the blocked resources, and name these."""
    if not bench.left_out:
        return run_check(check, bench)
    reason = f"without {', '.join(sorted(bench.left_out))}, which a command blocked"
    resources = bench.manifest().file.resources  # empty if only the settings determine them
    if resources and bench.left_out.issuperset(resources):
        return CheckResult(check, "skipped", (reason,))
    result = run_check(check, bench)
    return result if result.outcome == "failed" else replace(result, problems=(*result.problems, reason))
