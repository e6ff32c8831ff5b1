"""`make lab`: emulators behind the wires of a fleet, scenarios on it, and how far off its robots are in the end."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.emulators import Emulators, Pose, Wire, open_wires
from eal_actors.cli.output import new_table, stderr, stdout
from eal_actors.cli.run import run_scenario

_SCENARIOS: Final = (Path("square"), Path("dance"))
_MOVE: Final = re.compile(r"([gbflr])(\d+(?:\.\d+)?)?")
_STEP_M: Final = 0.5  # of g and b, unless a scenario sets it otherwise
_TURN_DEG: Final = 90.0


def run_lab(
    context: typer.Context,
    scenarios: Annotated[list[Path] | None, typer.Argument()] = None,
    fleet: Annotated[Path, typer.Option("--fleet", "-f")] = Path("lab"),
    runs_dir: Annotated[Path, typer.Option()] = Path("runs"),
) -> None:
    """Put emulators behind the open wires of a fleet, run scenarios on it, and tell where the robots have got to."""
    wires, before = open_wires(fleet), set(runs_dir.glob("*"))
    emulators = Emulators(wires)
    try:
        with emulators:
            _tell_wires(wires, emulators.addresses)
            for scenario in scenarios or _SCENARIOS:
                run_scenario(context, scenario, fleet, runs_dir=runs_dir, no_plot=True)
    finally:
        runs = sorted(set(runs_dir.glob("*")) - before, key=lambda run: run.stat().st_mtime_ns)
        _tell_poses(dict(sorted(emulators.poses.items())), runs)


def _tell_wires(wires: Sequence[Wire], addresses: Mapping[str, str]) -> None:
    for wire in wires:
        line = f"{wire.robot}: {wire.plugin} at {addresses[wire.variable]}, emulated; ${wire.variable} names another"
        stderr().print(Text(line, style="dim"), soft_wrap=True)


def _tell_poses(poses: Mapping[str, Pose], runs: Sequence[Path]) -> None:
    """Tell where the emulated robots are, and how far that is from where all that they were told leads."""
    if not runs:
        return
    table = new_table("robot", "should be at", "is at", "off by")
    for robot, pose in poses.items():
        moves = commands(robot, runs)
        table.add_row(robot, *_compared(pose, None if moves is None else destination(moves)))
    stdout().print(table)


def _compared(pose: Pose, wanted: Pose | None) -> tuple[str, str, str]:
    if wanted is None:
        return "unknown", _shown(pose), ""
    off_mm, off_deg = math.dist(pose[:2], wanted[:2]) * 1000, abs(math.remainder(pose[2] - wanted[2], 360.0))
    return _shown(wanted), _shown(pose), f"{off_mm:.1f} mm, {off_deg:.2f}°"


def commands(robot: str, runs: Iterable[Path]) -> list[str] | None:
    """Return the commands that a robot's base has carried out in runs; None if one of them was cut short.

    Args:
        robot: its name.
        runs: the folders of the runs, in their order.
    """
    found = []
    for run in runs:
        summary = run / "summary.json"
        steps = json.loads(summary.read_text(encoding="utf-8"))["steps"] if summary.exists() else [{}]
        moves = [step for step in steps if step.get("robot", robot) == robot and step.get("resource", "Base") == "Base"]
        if any(step.get("outcome") != "done" or step["attempts"] != 1 for step in moves):
            return None
        found += [step["command"] for step in sorted(moves, key=lambda step: float(step["start_s"]))]
    return found


def destination(moves: Iterable[str]) -> Pose:
    """Return where commands of a base lead from (0, 0, 0), for one that drives exactly."""
    x_m = y_m = yaw_deg = 0.0
    for move in moves:
        if (parsed := _MOVE.fullmatch(move)) is None:
            continue
        what, amount = parsed.groups()
        if what in "lr":
            yaw_deg += float(amount or _TURN_DEG) * (1 if what == "l" else -1)
        else:
            length_m = float(amount or _STEP_M) * (-1 if what == "b" else 1)
            x_m += length_m * math.cos(math.radians(yaw_deg))
            y_m += length_m * math.sin(math.radians(yaw_deg))
    return x_m, y_m, math.remainder(yaw_deg, 360.0)


def _shown(pose: Pose) -> str:
    x_m, y_m, yaw_deg = (round(number, 4) + 0.0 for number in pose)
    return f"{x_m:.3f} m, {y_m:.3f} m, {yaw_deg:.1f}°"
