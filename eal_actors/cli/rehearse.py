"""`eal rehearse`: a scenario in simulation first, and who comes too near to what."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import counted, new_table, stderr, stdout, write_json
from eal_actors.cli.progress import STYLES
from eal_actors.cli.run_options import Order, Wanted, read_order
from eal_actors.lab.rehearsal import Incident, Nearest, Rehearsal, rehearse
from eal_actors.lab.rehearsal.approaches import TOUCH_M
from eal_actors.managers.twins import SimulatedFleet, simulated
from eal_actors.scenario import Scenario
from eal_actors.scenario.language.binding import find_candidates

_SEEDS = 3

KeepOption = Annotated[
    list[str] | None,
    typer.Option(
        "--keep", metavar="PLUGIN", help="A plugin that moves nothing real, and runs as it is; may be repeated."
    ),
]


def rehearse_scenario(
    scenario: Annotated[
        Path,
        typer.Argument(metavar="SCENARIO", help="The scenario file, or a shipped one by name.", show_default=False),
    ],
    fleet: FleetOption,
    margin: Annotated[float, typer.Option(min=0, max=10, help="What comes nearer than this is told, in metres.")] = 0.1,
    seeds: Annotated[
        int | None,
        typer.Option(min=1, max=10_000, show_default=str(_SEEDS), help="How many seeds, from the fleet file's on."),
    ] = None,
    seed: Annotated[
        list[int] | None, typer.Option(min=0, show_default=False, help="A seed; may be repeated, in place of --seeds.")
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="The value of a parameter; may be given several times."),
    ] = None,
    bindings: Annotated[
        list[str] | None,
        typer.Option("--bind", metavar="ROLE=ROBOT,...", help="Who takes a role, in place of what the scenario says."),
    ] = None,
    keep: KeepOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rehearse a scenario in simulation: does anybody come too near to anything?

    Runs the scenario once for each seed, as fast as the machine goes, with all robots of the fleet in the world.
    Nothing real is moved: a robot with a driver is replaced by the simulation's model of it. After every step of the
    simulation, the distances between the outlines of robots, and from them to walls, obstacles, boxes and drops, are
    looked at.

    Ends with 1 if something comes nearer than the margin, or if a run is not done.
    """
    if seeds is not None and seed:
        raise typer.BadParameter("give the seeds, or how many", param_hint="'--seeds' / '--seed'")
    order = read_order(Wanted(scenario, fleet, settings or (), bindings or ()))
    bound = find_candidates(order.scenario, order.config, order.binding)
    twins = simulated(order.config, {name for names in bound.values() for name in names}, keep or ())
    first = order.config.seed
    chosen = list(dict.fromkeys(seed)) if seed else list(range(first, first + (seeds or _SEEDS)))
    console = stderr() if as_json else stdout()
    _print_changes(console, twins)
    done = _rehearse_all(console, order, twins, margin, chosen)
    if as_json:
        write_json(_as_json(order, twins, margin, done))
    else:
        _print(console, order, margin, done)
    if not all(one.is_clear for one in done):
        raise typer.Exit(ExitCode.FAILED)


def _rehearse_all(
    console: Console, order: Order, twins: SimulatedFleet, margin_m: float, seeds: Sequence[int]
) -> list[Rehearsal]:
    done: list[Rehearsal] = []
    for seed in seeds:
        with TemporaryDirectory(prefix="eal-rehearse-") as folder:
            if console.is_terminal:
                with console.status(f"seed {seed}"):
                    done.append(rehearse(order.scenario, twins, margin_m, seed, Path(folder) / "run", order.binding))
            else:
                done.append(rehearse(order.scenario, twins, margin_m, seed, Path(folder) / "run", order.binding))
    return done


def _print_changes(console: Console, twins: SimulatedFleet) -> None:
    for name, why in twins.replaced.items():
        console.print(Text(f"{name}: {why}", style="dim"), soft_wrap=True)
    for name, why in twins.left_out.items():
        console.print(Text(f"{name}: left out: {why}", style="yellow"), soft_wrap=True)


def _print(console: Console, order: Order, margin_m: float, done: Sequence[Rehearsal]) -> None:
    table = new_table("robot", "starts at", "nearest", "to", "time", "seed")
    for column in (table.columns[2], *table.columns[4:]):
        column.justify = "right"
    for name in dict.fromkeys(name for one in done for name in one.starts):
        table.add_row(name, *_worst(name, margin_m, done))
    console.print(table)
    console.print()
    for one in done:
        if one.report.outcome != "done":
            why = one.report.error.message if one.report.error is not None else ""
            line = Text.assemble(f"seed {one.seed}: ", (one.report.outcome, STYLES[one.report.outcome]), f": {why}")
            console.print(line, soft_wrap=True)
        for incident in one.incidents:
            console.print(_line(order.scenario, one.seed, incident), soft_wrap=True)
    console.print(_verdict(order, margin_m, done), soft_wrap=True)


def _worst(name: str, margin_m: float, done: Sequence[Rehearsal]) -> tuple[str | Text, ...]:
    """Return where a robot stood first, and the nearest that anything came to it in all runs."""
    start = next((_place(one.starts[name]) for one in done if name in one.starts), "")
    seen = [(one.nearest[name], one.seed) for one in done if name in one.nearest]
    if not seen:
        return start, "over 1 m", "", "", ""
    nearest, seed = min(seen, key=lambda pair: pair[0].gap_m)
    style = "red" if nearest.gap_m < margin_m else "green"
    return start, Text(_metres(nearest.gap_m), style), nearest.other, f"{nearest.time_s:.2f} s", str(seed)


def _line(scenario: Scenario, seed: int, incident: Incident) -> Text:
    approach, nearest = incident.approach, incident.approach.nearest
    what = (
        ("hits ", "bold red") if approach.is_hit else (f"comes within {_metres(nearest.gap_m)} of ", STYLES["dropped"])
    )
    during = "; ".join(
        f"{step.robot} {step.label} ({scenario.position_of(step.step).file}:{scenario.position_of(step.step).line})"
        for step in incident.steps
    )
    return Text.assemble(
        f"{nearest.time_s:8.2f} s  seed {seed}  {approach.robot} ",
        what,
        f"{nearest.other} at {_place(nearest.place_m)}",
        f" during {during}" if during else " before a step of theirs is under way",
    )


def _verdict(order: Order, margin_m: float, done: Sequence[Rehearsal]) -> Text:
    incidents = [incident for one in done for incident in one.incidents]
    hits = sum(incident.approach.is_hit for incident in incidents)
    unfinished = sum(one.report.outcome != "done" for one in done)
    if all(one.is_clear for one in done):
        what = (f"clear: nothing comes nearer than {margin_m:g} m", "green")
    else:
        parts = [counted(hits, "hit")] if hits else []
        if near := len(incidents) - hits:
            parts.append(f"{counted(near, 'approach') if near == 1 else f'{near} approaches'} under {margin_m:g} m")
        if unfinished:
            parts.append(f"{counted(unfinished, 'run')} not done")
        what = (", ".join(parts), "bold red")
    seeds = ", ".join(str(one.seed) for one in done)
    return Text.assemble(
        f"{order.scenario.name} on {order.config.name}, {'seed' if len(done) == 1 else 'seeds'} {seeds}: ", what
    )


def _metres(gap_m: float) -> str:
    return f"{gap_m:.3f} m" if gap_m > TOUCH_M else "contact"


def _place(place_m: tuple[float, float]) -> str:
    return f"x {place_m[0]:.2f} m, y {place_m[1]:.2f} m"


def _as_json(order: Order, twins: SimulatedFleet, margin_m: float, done: Sequence[Rehearsal]) -> dict[str, Any]:
    return {
        "scenario": order.scenario.name,
        "fleet": order.config.name,
        "parameters": dict(order.scenario.parameters),
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
                "nearest": {name: _nearest(nearest) for name, nearest in one.nearest.items()},
                "incidents": [_incident(order.scenario, incident) for incident in one.incidents],
            }
            for one in done
        ],
    }


def _incident(scenario: Scenario, incident: Incident) -> dict[str, Any]:
    approach = incident.approach
    steps = [(step, scenario.position_of(step.step)) for step in incident.steps]
    return {
        "robot": approach.robot,
        "is_hit": approach.is_hit,
        "start_s": approach.start_s,
        "end_s": approach.end_s,
        **_nearest(approach.nearest),
        "steps": [
            {"robot": step.robot, "step": step.step, "label": step.label, "file": mark.file, "line": mark.line}
            for step, mark in steps
        ],
    }


def _nearest(nearest: Nearest) -> dict[str, Any]:
    return {
        "other": nearest.other,
        "gap_m": nearest.gap_m,
        "time_s": nearest.time_s,
        "x_m": nearest.place_m[0],
        "y_m": nearest.place_m[1],
    }
