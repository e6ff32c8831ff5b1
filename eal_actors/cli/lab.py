"""`make lab`: emulate the open devices of a fleet, run scenarios on it, and compare where the robots end."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.emulators import EmulatorProcesses, LabDevice, LabPose, open_devices
from eal_actors.cli.output import new_table, stderr, stdout
from eal_actors.cli.run import run_scenario

_SCENARIOS: Final = (Path("square"), Path("dance"))
_MOVE: Final = re.compile(r"([gbflr])(\d+(?:\.\d+)?)?")
_GUIDED: Final = ("go_to", "visit", "follow", "formation")  # kinds of steps that end by the estimated pose
_STEP_M: Final = 0.5  # default of g and b
_TURN_DEG: Final = 90.0


def run_lab(
    context: typer.Context,
    scenarios: Annotated[list[Path] | None, typer.Argument()] = None,
    fleet: Annotated[Path, typer.Option("--fleet", "-f")] = Path("lab"),
    runs_dir: Annotated[Path, typer.Option()] = Path("runs"),
) -> None:
    """Emulate the open devices of a fleet, run scenarios on it, and print where the robots ended.

    If the fleet has a world, the emulated robots are in it, and its cameras see them.
    """
    devices, before = open_devices(fleet), set(runs_dir.glob("*"))
    emulators = EmulatorProcesses(devices, fleet)
    try:
        with emulators:
            _print_devices(devices, emulators.addresses)
            for scenario in scenarios or _SCENARIOS:
                run_scenario(context, scenario, fleet, runs_dir=runs_dir, no_plot=True)
    finally:
        runs = sorted(set(runs_dir.glob("*")) - before, key=lambda run: run.stat().st_mtime_ns)
        _print_poses(emulators, runs)


def _print_devices(devices: Sequence[LabDevice], addresses: Mapping[str, str]) -> None:
    for device in devices:
        variables = device.variables.values()
        place, names = (":".join(addresses[name] for name in variables), ", ".join(f"${name}" for name in variables))
        part = f" ({device.part})" if device.part else ""
        line = f"{device.robot}: {device.plugin.name}{part} at {place}, emulated; {names} names another"
        stderr().print(Text(line, style="dim"), soft_wrap=True)


def _print_poses(emulators: EmulatorProcesses, runs: Sequence[Path]) -> None:
    """Print the pose of each emulated robot and its distance from the goal of its commands, or why it has none."""
    poses, failures = emulators.poses, emulators.failures
    if not runs and not failures:
        return
    table = new_table("robot", "should be at", "is at", "off by")
    for robot in sorted({*poses, *failures}):
        moves = commands(robot, runs)
        wanted = None if moves is None else destination(moves, emulators.starts.get(robot, (0.0, 0.0, 0.0)))
        if robot in failures:
            table.add_row(robot, _format_pose(wanted) if wanted else "unknown", failures[robot], "")
        else:
            table.add_row(robot, *_compare(poses[robot], wanted))
    stdout().print(table)


def _compare(pose: LabPose, wanted: LabPose | None) -> tuple[str, str, str]:
    if wanted is None:
        return "unknown", _format_pose(pose), ""
    off_mm, off_deg = math.dist(pose[:2], wanted[:2]) * 1000, abs(math.remainder(pose[2] - wanted[2], 360.0))
    return _format_pose(wanted), _format_pose(pose), f"{off_mm:.1f} mm, {off_deg:.2f}°"


def commands(robot: str, runs: Iterable[Path]) -> list[str] | None:
    """Return the commands that a robot's base completed in runs; None if one was cut short, or places were goals."""
    found = []
    for run in runs:
        summary = run / "summary.json"
        steps = json.loads(summary.read_text(encoding="utf-8"))["steps"] if summary.exists() else [{}]
        if any(step.get("robot") == robot and step.get("kind") in _GUIDED for step in steps):
            return None
        moves = [step for step in steps if step.get("robot", robot) == robot and step.get("resource", "Base") == "Base"]
        if any(step.get("outcome") != "done" or step["attempts"] != 1 for step in moves):
            return None
        found += [step["command"] for step in sorted(moves, key=lambda step: float(step["start_s"]))]
    return found


def destination(moves: Iterable[str], start: LabPose = (0.0, 0.0, 0.0)) -> LabPose:
    """Return the pose to which a base's commands lead from its start without any error."""
    x_m, y_m, yaw_deg = start
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


def _format_pose(pose: LabPose) -> str:
    x_m, y_m, yaw_deg = (round(number, 4) + 0.0 for number in pose)
    return f"{x_m:.3f} m, {y_m:.3f} m, {yaw_deg:.1f}°"
