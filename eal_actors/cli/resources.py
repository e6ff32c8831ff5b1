"""`eal resources`: list the robots of a fleet, and their resources."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from eal_actors.actors.handles import RobotHandle
from eal_actors.actors.robot_view import RobotState
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import read_fleet
from eal_actors.cli.options import FleetOption, JsonOption
from eal_actors.cli.output import counted, new_table, stdout, write_json
from eal_actors.device.info import METHODS, ResourceInfo
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.managers.missing_modules import require_modules

_NAMES_SHOWN = 4


def list_resources(
    fleet: FleetOption,
    robot: Annotated[list[str] | None, typer.Option("--robot", "-r", help="Only this robot; repeatable.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Connect the robots and list their resources, with methods, commands, types, units and ranges.

    Robots with the same resources are listed together. The exit code is 3 if a robot could not be reached.
    """
    config = read_fleet(fleet, robot or ())
    require_modules(config, config.robots)
    with Fleet(config) as opened:
        robots = [_robot_as_json(handle) for handle in opened.values()]
    if as_json:
        write_json({"fleet": opened.name, "robots": robots})
    else:
        _print_groups(robots)
    if any(entry["state"] != RobotState.READY.value or entry["problems"] for entry in robots):
        raise typer.Exit(ExitCode.UNREACHABLE)


def _robot_as_json(robot: RobotHandle) -> dict[str, Any]:
    infos = []
    missing = []
    for name, handle in robot.items():
        try:
            infos.append(handle.info.to_dict())
        except EALError as error:
            missing.append(f"{name}: {error.message}")
    return {
        "name": robot.name,
        "type": robot.type,
        "tags": list(robot.tags),
        "state": robot.state.value,
        "problems": [*(problem.message for problem in robot.problems), *missing],
        "resources": infos,
    }


def _print_groups(robots: list[dict[str, Any]]) -> None:
    """Print robots with the same resources, state and problems under one heading."""
    groups = _grouped(robots, ("state", "problems", "resources"))
    console = stdout()
    for number, group in enumerate(groups):
        if number:
            console.print()
        for alike in _grouped(group, ("type", "tags")):
            console.print(_heading(alike), soft_wrap=True)
        for problem in group[0]["problems"]:
            console.print(Text(f"  {problem}", style="red"))
        if group[0]["resources"]:
            console.print()
            console.print(_table([ResourceInfo.from_dict(info) for info in group[0]["resources"]]))


def _grouped(robots: list[dict[str, Any]], keys: tuple[str, ...]) -> list[list[dict[str, Any]]]:
    groups: dict[str, list[dict[str, Any]]] = {}
    for robot in robots:
        groups.setdefault(json.dumps([robot[key] for key in keys]), []).append(robot)
    return list(groups.values())


def _heading(alike: list[dict[str, Any]]) -> Text:
    robot, names = alike[0], [entry["name"] for entry in alike]
    many = f"{names[0]} to {names[-1]} ({counted(len(names), 'robot')})"
    listed = ", ".join(names) if len(names) <= _NAMES_SHOWN else many
    state, style = robot["state"], "green" if robot["state"] == RobotState.READY.value else "bold red"
    if state == RobotState.READY.value and robot["problems"]:
        state, style = "incomplete", "yellow"
    notes = f"  type {robot['type']}" if robot["type"] else ""
    notes += f"  tags {', '.join(robot['tags'])}" if robot["tags"] else ""
    return Text.assemble((listed, "bold"), "  ", (state, style), (notes, "dim"))


def _table(infos: list[ResourceInfo]) -> Table:
    table = new_table("resource", "types", "methods", "interface")
    for info in infos:
        types = "\n".join(name.lower() for name in info.types.names)
        methods = "\n".join(method for method in METHODS if method in info.methods)
        table.add_row(Text(info.name, style="cyan"), types, methods, _interface(info))
        table.add_section()
    return table


def _interface(info: ResourceInfo) -> Text:
    lines = [Text(info.description, style="italic")]
    if info.value is not None:
        note = f", {info.value.description}" if info.value.description else ""
        lines.append(_interface_line("value", f"{info.value.describe()}{note}"))
    bare = [f"{command.name}{' (stop)' if command.urgent else ''}" for command in info.commands if not command.argument]
    if bare:
        lines.append(_interface_line("command", ", ".join(bare)))
    lines += [_interface_line("command", command.describe()) for command in info.commands if command.argument]
    for request in info.requests:
        answer = f": {request.returns.describe()}" if request.returns else ""
        lines.append(_interface_line("request", f"{request.describe()}{answer}"))
    for key in info.configs:
        access = "" if key.writable else " read-only"
        lines.append(_interface_line("config", f"{key.name} ({key.value.describe()}){access}"))
    return Text("\n").join(lines)


def _interface_line(kind: str, text: str) -> Text:
    return Text.assemble((f"{kind} ", "dim"), text)
