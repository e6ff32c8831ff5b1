"""`eal prove`: run a scenario in simulation under every fault at every step of every robot."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import (
    BindingsOption,
    FleetOption,
    JobsOption,
    JsonOption,
    KeepOption,
    ScenarioArgument,
    SettingsOption,
)
from eal_actors.cli.output import counted, new_table, print_line, stderr, stdout, write_json
from eal_actors.cli.run_options import RunOptions, read_request
from eal_actors.cli.work import work_progress
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import UnsupportedError, unwritable_error
from eal_actors.lab.proof import Finding, Proof, ProofRequest, ProvenCase, prove
from eal_actors.lab.proof.cases import KILLED
from eal_actors.lab.proof.fleet_files import injectable_faults
from eal_actors.lab.proof.page import render_proof
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.twins import simulated

_RUNS: Final = 250
_PAGE: Final = "proof.html"


def prove_scenario(
    scenario: ScenarioArgument,
    fleet: FleetOption,
    runs: Annotated[int, typer.Option(min=1, help="Largest number of runs; a fifth is for pairs of faults.")] = _RUNS,
    fault: Annotated[list[str] | None, typer.Option(metavar="NAME", help="Only this fault; repeatable.")] = None,
    within: Annotated[
        float | None, typer.Option(min=0.1, help="Every run must end within this time, in seconds of its clock.")
    ] = None,
    settings: SettingsOption = None,
    bindings: BindingsOption = None,
    jobs: JobsOption = None,
    out: Annotated[Path | None, typer.Option(show_default="proofs/<scenario>", help="Folder of the proof.")] = None,
    keep: KeepOption = None,
    as_json: JsonOption = False,
) -> None:
    """Prove that a scenario ends well under every fault at every step of every robot, in simulation.

    The scenario runs once without faults. Then it runs again and again in lock step, each time with one fault in one
    step of one robot, or with a pair of them. Every run is judged: it ends, nobody waits in vain, all robots end
    halted, no two robots touch, `finally` is performed, deadlines and `min` hold, and no run is done that was not.
    Each finding is shrunk to the least fleet file that shows it. proof.html has the matrix of steps and faults.

    No real robot moves. The exit code is 1 if there is a finding.
    """
    request = read_request(RunOptions(scenario, fleet, settings or (), bindings or ()))
    _check_kinds(fault or (), request.config, keep or ())
    console = stderr() if as_json else stdout()
    asked = ProofRequest(
        request.scenario,
        request.config,
        out or Path("proofs") / request.scenario.name,
        request.binding,
        keep or (),
        runs,
        jobs or os.cpu_count() or 1,
        fault or (),
        within,
    )
    try:
        with work_progress(console, "run", None) as on_done:
            proof = prove(asked, lambda case, count: on_done(_case_line(case), bool(case.violations), count))
        page = _write_page(proof, console)
    except OSError as error:
        raise unwritable_error(error.filename or asked.out, error) from error
    if as_json:
        write_json(_proof_as_json(proof, page))
    else:
        _print_proof(console, proof, page)
    if not proof.is_proven:
        raise typer.Exit(ExitCode.FAILED)


def _check_kinds(kinds: Sequence[str], config: FleetConfig, keep: Sequence[str]) -> None:
    faults = injectable_faults(simulated(config, (), keep).config).values()
    known = dict.fromkeys([*(name for _, declared in faults for name in declared), KILLED])
    for kind in kinds:
        if kind not in known:
            raise typer.BadParameter(f"there is no fault {kind!r}; use {', '.join(known)}", param_hint="'--fault'")


def _case_line(case: ProvenCase) -> Text:
    if not case.violations:
        return Text(f"{case.label}: {case.outcome}")
    first = case.violations[0]
    return Text.assemble((f"{first.invariant}: ", "bold red"), first.message, f"  ({case.label})")


def _write_page(proof: Proof, console: Console) -> Path | None:
    try:
        text = render_proof(proof)
    except UnsupportedError as error:
        print_line(console, f"no page: {error.message}", "yellow")
        return None
    file = proof.out / _PAGE
    file.write_text(text, encoding="utf-8")
    return file


def _table(proof: Proof) -> Table:
    table = new_table("fault", "runs", "done", "failed safely", "findings", right=("runs", "done", "failed safely"))
    for kind in (*proof.kinds, "pairs"):
        cases = [case for case in proof.cases if (len(case.case) > 1) == (kind == "pairs")]
        cases = [case for case in cases if kind in ("pairs", case.case[0].kind)]
        bad = sum(bool(case.violations) for case in cases)
        done = sum(case.outcome == "done" and not case.violations for case in cases)
        if cases:
            style = "bold red" if bad else "green"
            table.add_row(kind, str(len(cases)), str(done), str(len(cases) - done - bad), Text(str(bad), style))
    return table


def _print_proof(console: Console, proof: Proof, page: Path | None) -> None:
    console.print(_table(proof))
    for name, why in proof.unprovable.items():
        print_line(console, f"{name}: no faults tried: {why}", "yellow")
    for one, other in proof.touching:
        print_line(console, f"{one} and {other} touch without faults: their contacts are not judged", "yellow")
    for number, finding in enumerate(proof.findings, 1):
        print_line(console, _finding_line(number, finding))
        if finding.fleet_file is not None and finding.least is not None:
            robots, faults = finding.least.size
            size = f"{counted(robots, 'robot')}, {counted(faults, 'fault')}"
            print_line(console, f"   least fleet ({size}): {short_path(finding.fleet_file)}", "dim")
    print_line(console, _verdict(proof))
    if page is not None:
        print_line(console, f"html: {page}", "dim")


def _finding_line(number: int, finding: Finding) -> Text:
    cases = counted(len(finding.cases), "run")
    message = f"{finding.violation.message}  ({cases}; {finding.cases[0].label})"
    return Text.assemble(f"{number}. ", (f"{finding.invariant}: ", "bold red"), message)


def _verdict(proof: Proof) -> Text:
    tried = f"{counted(len(proof.cases), 'run')}, {proof.singles} of {proof.planned} single faults"
    verdict = ("all invariants hold", "green") if proof.is_proven else (counted(len(proof.findings), "finding"), "red")
    return Text.assemble(f"{proof.scenario.name} on {proof.fleet}, {tried}: ", verdict)


def _proof_as_json(proof: Proof, page: Path | None) -> dict[str, Any]:
    return {
        "scenario": proof.scenario.name,
        "fleet": proof.fleet,
        "is_proven": proof.is_proven,
        "single_faults": proof.planned,
        "page": None if page is None else str(page),
        "not_tried": dict(proof.unprovable),
        "touching": [list(pair) for pair in proof.touching],
        "runs": [
            {
                "faults": [asdict(fault) for fault in case.case],
                "outcome": case.outcome,
                "duration_s": case.duration_s,
                "error": case.problem or None,
                "violations": [asdict(violation) for violation in case.violations],
            }
            for case in proof.cases
        ],
        "findings": [
            {
                "invariant": finding.invariant,
                "message": finding.violation.message,
                "runs": len(finding.cases),
                "least_fleet": None if finding.fleet_file is None else str(finding.fleet_file),
                "robots": None if finding.least is None else finding.least.size[0],
                "faults": [fault.label for fault in (finding.least or finding.cases[0]).case],
            }
            for finding in proof.findings
        ],
    }
