"""`eal rehearse`: run a scenario in simulation, and report where robots come too close to anything."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import BindingsOption, FleetOption, JsonOption, KeepOption, ScenarioArgument, SettingsOption
from eal_actors.cli.output import counted, new_table, print_line, stderr, stdout, write_json
from eal_actors.cli.progress import STYLES
from eal_actors.cli.run_options import RunOptions, RunRequest, read_request
from eal_actors.cli.work import work_progress
from eal_actors.lab.rehearsal.proximity import TOUCH_M, ClosestApproach
from eal_actors.lab.rehearsal.rehearse import Incident, Rehearsal, rehearse
from eal_actors.managers.twins import SimulatedFleet, simulated
from eal_actors.scenario import Scenario, StepRecord
from eal_actors.scenario.language.binding import bound_robots

_SEEDS = 3


def rehearse_scenario(
    scenario: ScenarioArgument,
    fleet: FleetOption,
    margin: Annotated[float, typer.Option(min=0, max=10, help="Report anything closer than this, in metres.")] = 0.1,
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1, max=10_000, show_default=str(_SEEDS), help="Number of seeds, counted from the fleet file's."
        ),
    ] = None,
    seed: Annotated[list[int] | None, typer.Option(min=0, help="A seed, instead of --seeds; repeatable.")] = None,
    settings: SettingsOption = None,
    bindings: BindingsOption = None,
    keep: KeepOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rehearse a scenario in simulation, and report robots that come too close to anything.

    The scenario runs once for each seed, as fast as possible, with all robots of the fleet in the world. No real robot
    moves: a robot with a driver is replaced by its simulated model. After every step of the simulation the command
    measures the gaps between robots, and between robots and walls, obstacles, boxes and drops.

    The exit code is 1 if a gap is smaller than the margin, or if a run is not done.
    """
    if seeds is not None and seed:
        raise typer.BadParameter("give either --seed or --seeds", param_hint="'--seeds' / '--seed'")
    request = read_request(RunOptions(scenario, fleet, settings or (), bindings or ()))
    twins = simulated(request.config, bound_robots(request.scenario, request.config, request.binding), keep or ())
    first = request.config.seed
    chosen = list(dict.fromkeys(seed)) if seed else list(range(first, first + (seeds or _SEEDS)))
    console = stderr() if as_json else stdout()
    for name, why in twins.replaced.items():
        print_line(console, f"{name}: {why}", "dim")
    for name, why in twins.left_out.items():
        print_line(console, f"{name}: left out: {why}; --keep PLUGIN uses one itself", "yellow")
    done = _rehearse_all(console, request, twins, margin, chosen)
    if as_json:
        write_json(_rehearsals_as_json(request, twins, margin, done))
    else:
        _print_rehearsals(console, request, margin, done)
    if len(done) < len(chosen):
        raise typer.Exit(ExitCode.INTERRUPTED)
    if not all(one.is_clear for one in done):
        raise typer.Exit(ExitCode.FAILED)


def _rehearse_all(
    console: Console, request: RunRequest, twins: SimulatedFleet, margin_m: float, seeds: Sequence[int]
) -> list[Rehearsal]:
    """Return the rehearsals with all seeds; with those that are done, if Ctrl-C is pressed after the first."""
    done: list[Rehearsal] = []
    try:
        with work_progress(stderr(), "seed", len(seeds)) as on_done:
            for seed in seeds:
                with TemporaryDirectory(prefix="eal-rehearse-") as folder:
                    run = Path(folder) / "run"
                    done.append(rehearse(request.scenario, twins, margin_m, seed, run, request.binding))
                on_done(f"seed {seed}: {done[-1].report.outcome}", False)
    except KeyboardInterrupt:
        if not done:
            raise
        print_line(console, f"Stopped after {counted(len(done), 'seed')} of {len(seeds)}.", "yellow")
    return done


def _print_rehearsals(console: Console, request: RunRequest, margin_m: float, done: Sequence[Rehearsal]) -> None:
    table = new_table("robot", "starts at", "closest", "to", "time", "seed", right=("closest", "time", "seed"))
    for name in dict.fromkeys(name for one in done for name in one.starts):
        table.add_row(name, *_worst(name, margin_m, done))
    console.print(table)
    console.print()
    for one in done:
        if one.report.outcome != "done":
            why = one.report.error.message if one.report.error is not None else ""
            line = Text.assemble(f"seed {one.seed}: ", (one.report.outcome, STYLES[one.report.outcome]), f": {why}")
            print_line(console, line)
        for incident in one.incidents:
            print_line(console, _incident_line(request.scenario, one.seed, incident))
    print_line(console, _verdict(request, margin_m, done))


def _worst(name: str, margin_m: float, done: Sequence[Rehearsal]) -> tuple[str | Text, ...]:
    """Return a robot's start and its closest approach in all runs."""
    start = next((_place(one.starts[name]) for one in done if name in one.starts), "")
    seen = [(one.nearest[name], one.seed) for one in done if name in one.nearest]
    if not seen:
        return start, "over 1 m", "", "", ""
    nearest, seed = min(seen, key=lambda pair: pair[0].gap_m)
    style = "red" if nearest.gap_m < margin_m else "green"
    return start, Text(_metres(nearest.gap_m), style), nearest.other, f"{nearest.time_s:.2f} s", str(seed)


def _incident_line(scenario: Scenario, seed: int, incident: Incident) -> Text:
    approach, nearest = incident.approach, incident.approach.nearest
    near = (f"comes within {_metres(nearest.gap_m)} of ", STYLES["dropped"])
    steps = ((step, scenario.position_of(step.step)) for step in incident.steps)
    during = "; ".join(f"{step.robot or step.role} {step.label} ({at.file}:{at.line})" for step, at in steps)
    return Text.assemble(
        f"{nearest.time_s:8.2f} s  seed {seed}  {approach.robot} ",
        ("hits ", "bold red") if approach.is_hit else near,
        f"{nearest.other} at {_place(nearest.place_m)}",
        f" during {during}" if during else " during none of their steps",
    )


def _verdict(request: RunRequest, margin_m: float, done: Sequence[Rehearsal]) -> Text:
    incidents = [incident for one in done for incident in one.incidents]
    hits = sum(incident.approach.is_hit for incident in incidents)
    unfinished = sum(one.report.outcome != "done" for one in done)
    if all(one.is_clear for one in done):
        verdict = (f"clear: no gap is smaller than {margin_m:g} m", "green")
    else:
        parts = [counted(hits, "hit")] if hits else []
        if near := len(incidents) - hits:
            parts.append(f"{counted(near, 'approach') if near == 1 else f'{near} approaches'} under {margin_m:g} m")
        if unfinished:
            parts.append(f"{counted(unfinished, 'run')} not done")
        verdict = (", ".join(parts), "bold red")
    seeds = ", ".join(str(one.seed) for one in done)
    return Text.assemble(
        f"{request.scenario.name} on {request.config.name}, {'seed' if len(done) == 1 else 'seeds'} {seeds}: ", verdict
    )


def _metres(gap_m: float) -> str:
    return f"{gap_m:.3f} m" if gap_m > TOUCH_M else "contact"


def _place(place_m: tuple[float, float]) -> str:
    return f"x {place_m[0]:.2f} m, y {place_m[1]:.2f} m"


def _rehearsals_as_json(
    request: RunRequest, twins: SimulatedFleet, margin_m: float, done: Sequence[Rehearsal]
) -> dict[str, Any]:
    return {
        "scenario": request.scenario.name,
        "fleet": request.config.name,
        "parameters": dict(request.scenario.parameters),
        "margin_m": margin_m,
        "is_clear": all(one.is_clear for one in done),
        "stand_ins": dict(twins.replaced),
        "left_out": dict(twins.left_out),
        "runs": [
            {
                "seed": one.seed,
                "outcome": one.report.outcome,
                "error": None if one.report.error is None else one.report.error.model_dump(),
                "duration_s": one.report.duration_s,
                "starts": {name: list(place) for name, place in one.starts.items()},
                "nearest": {name: _closest_as_json(nearest) for name, nearest in one.nearest.items()},
                "incidents": [_incident_as_json(request.scenario, incident) for incident in one.incidents],
                "failed_steps": _steps_as_json(
                    request.scenario, [step for step in one.report.steps if step.outcome == "failed"]
                ),
            }
            for one in done
        ],
    }


def _incident_as_json(scenario: Scenario, incident: Incident) -> dict[str, Any]:
    approach = incident.approach
    return {
        "robot": approach.robot,
        "is_hit": approach.is_hit,
        "start_s": approach.start_s,
        "end_s": approach.end_s,
        **_closest_as_json(approach.nearest),
        "steps": _steps_as_json(scenario, incident.steps),
    }


def _steps_as_json(scenario: Scenario, steps: Sequence[StepRecord]) -> list[dict[str, Any]]:
    found = []
    for step in steps:
        mark = scenario.position_of(step.step)
        place = {"file": mark.file, "line": mark.line, "column": mark.column}
        found.append({"robot": step.robot, "step": step.step, "label": step.label, **place})
    return found


def _closest_as_json(nearest: ClosestApproach) -> dict[str, Any]:
    x_m, y_m = nearest.place_m
    return {"other": nearest.other, "gap_m": nearest.gap_m, "time_s": nearest.time_s, "x_m": x_m, "y_m": y_m}
