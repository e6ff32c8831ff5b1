"""`eal doctor`: check a machine and a fleet, with advice on each problem."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.options import JsonOption, RobotsArgument
from eal_actors.cli.output import PAGE_WIDTH, counted, new_table, stdout, write_json
from eal_actors.kernel.bundled import FLEET_VARIABLE
from eal_actors.kernel.errors import ConfigError
from eal_actors.operate.doctor import Diagnostic, Severity, diagnose_fleet, diagnose_machine

_SIGNS: Final = {Severity.OK: ("✓", "+"), Severity.WARNING: ("▲", "!"), Severity.PROBLEM: ("✗", "x")}
_STYLES: Final = {Severity.OK: "green", Severity.WARNING: "yellow", Severity.PROBLEM: "bold red"}


def examine(
    fleet: Annotated[
        Path | None,
        typer.Option(
            "--fleet", "-f", envvar=FLEET_VARIABLE, help="The fleet file; without it, only the machine is checked."
        ),
    ] = None,
    robots: RobotsArgument = None,
    as_json: JsonOption = False,
) -> None:
    """Check this machine and a fleet, with advice on each problem.

    Checks packages, clock, plugins, devices and their permissions, cameras, certificates and ports. Pings the robots of
    other processes. No robot moves. Exits with 1 if there is a problem; warnings do not count.
    """
    if robots and fleet is None:
        why = f"{robots[0]}: without --fleet there are no robots to check"
        raise typer.BadParameter(why, param_hint="'[ROBOT]...'")
    findings = [*diagnose_machine(), *(_of_fleet(fleet, robots or []) if fleet is not None else ())]
    problems = sum(finding.level is Severity.PROBLEM for finding in findings)
    if as_json:
        write_json({"problems": problems, "findings": [finding._asdict() for finding in findings]})
    else:
        _print(findings, problems)
    if problems:
        raise typer.Exit(ExitCode.FAILED)


def _of_fleet(fleet: Path, robots: list[str]) -> Iterator[Diagnostic]:
    try:
        config = read_fleet(fleet, robots)
    except ConfigError as error:
        advice = "Correct the file there, then check it with eal check."
        yield from (Diagnostic(Severity.PROBLEM, "fleet file", str(problem), advice) for problem in error.problems)
        return
    yield from diagnose_fleet(config)


def _print(findings: list[Diagnostic], problems: int) -> None:
    console = stdout(PAGE_WIDTH)
    is_rich = console.encoding.startswith("utf")
    arrow = "→" if is_rich else "->"
    table = new_table("", "area", "finding")
    for finding in findings:
        rich, plain = _SIGNS[finding.level]
        what = Text(finding.what)
        if finding.advice:
            style = "bold" if finding.level is Severity.PROBLEM else "dim"
            what.append(f"\n{arrow} {finding.advice}", style=style)
        sign = Text(f"{rich if is_rich else plain} {finding.level}", style=_STYLES[finding.level])
        table.add_row(sign, finding.area, what)
    console.print(table)
    warnings = sum(finding.level is Severity.WARNING for finding in findings)
    style = _STYLES[Severity.PROBLEM if problems else Severity.WARNING if warnings else Severity.OK]
    console.print(Text(f"{counted(problems, 'problem')}, {counted(warnings, 'warning')}", style=style))
