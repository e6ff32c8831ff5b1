"""`eal new`: write a first fleet, scenario or world file, from two answers."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import Annotated, Final

import typer
import yaml

from eal_actors.cli.check import check_file
from eal_actors.cli.init import header_for
from eal_actors.cli.options import EalCommand, EalCommandGroup
from eal_actors.cli.output import print_line, stdout
from eal_actors.kernel.errors import ConfigError, file_error, writing
from eal_actors.kernel.strict_model import NAME_PATTERN
from eal_actors.kernel.suggestions import did_you_mean
from eal_actors.managers.network_model import new_identity
from eal_actors.managers.plugins import EALPluginManager

app = typer.Typer(cls=EalCommandGroup, help="Write a first fleet, scenario or world file.", no_args_is_help=True)

_FLEET: Final = """\
# The robots, and the plugin that drives each. Check it with: eal check {file}
version: 1
name: {name}
network: {{identity: {identity}}}  # tells this fleet from others of the same name
clock: {{rate: 2}}  # times real time; leave it out on hardware
world: lab  # the room of the simulated robots: the name of a bundled world, or a file beside this one
types:
  {type}:
    plugins:
      {plugin}: {settings}  # simulated; on hardware: {type}: {{...}}, see `eal plugin list`
robots:
  {robot}
"""
_SCENARIO: Final = """\
# What the robots do. Check it with: eal check {file}
version: 1
name: {name}
roles:
  movers: {{needs: {{Base: []}}}}  # every robot with a base
timeout_s: 60
on_failure: drop  # a robot that fails is dropped; the others continue
steps:
  - on: movers
    do:
      - for: {{move: {moves}}}
        do:
          - send_cmd: {{resource: Base, cmd: "${{move}}"}}{together}
finally:
  - on: movers
    do:
      - send_cmd: {{resource: Base, cmd: s}}  # stop
"""
_WORLD: Final = """\
# A room for simulated robots. Look at it with: eal world {file}
version: 1
name: {name}
size_m: [{width_m:g}, {depth_m:g}]  # along x and y; the origin is in the middle
{obstacles}places:  # goals by name
  home: {{x_m: 0, y_m: 0, yaw_deg: 0}}
"""
_TOGETHER: Final = "\n            together: true  # all robots begin each move at the same time"
_SIZE: Final = re.compile(r"(\d+(?:\.\d+)?)\s*[x,* ]\s*(\d+(?:\.\d+)?)")
_MOVE: Final = re.compile(r"[a-z][a-z0-9.]*")
_SPACING_M: Final = 1.2
_MOST_ROBOTS: Final = 100
_SIZE_M: Final = (2.0, 100.0)


@app.command("fleet", cls=EalCommand)
def new_fleet(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = Path("fleet.yaml"),
    robot: Annotated[
        str | None, typer.Option("--robot", show_default="asks", help="Type of the robots: a plugin with a simulation.")
    ] = None,
    count: Annotated[
        int | None, typer.Option(min=1, max=_MOST_ROBOTS, show_default="asks", help="How many robots.")
    ] = None,
) -> None:
    """Write a fleet of simulated robots of one type, which can run at once."""
    _refuse_existing(file)
    twins = {
        manifest.name: manifest.file.twin
        for manifest in EALPluginManager(()).manifests.values()
        if manifest.file.twin is not None
    }
    kind = robot or _ask(f"Type of the robots ({', '.join(twins)})", next(iter(twins)))
    if kind not in twins:
        raise typer.BadParameter(f"unknown type {kind!r}{did_you_mean(kind, twins)}", param_hint="'--robot'")
    number = count or _ask_number("How many robots", (1, _MOST_ROBOTS))
    twin = twins[kind]
    settings = yaml.safe_dump(twin.settings, default_flow_style=True, width=1000).strip()
    line = f"{kind}-1: {{type: {kind}}}" if number == 1 else f'"{kind}-{{n}}": {{type: {kind}, count: {number}}}'
    facts = {"type": kind, "plugin": twin.plugin, "settings": settings, "robot": line, "identity": new_identity()}
    text = _FLEET.format(file=file.name, name=_name_of(file), **facts)
    _write(file, "fleet", text, f"eal run dance --fleet {file}", f"eal dashboard --fleet {file}")


@app.command("scenario", cls=EalCommand)
def new_scenario(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = Path("scenario.yaml"),
    moves: Annotated[
        str | None, typer.Option(show_default="asks", help="Commands of a base, such as 'f0.5 l90'.")
    ] = None,
    together: Annotated[
        bool | None,
        typer.Option("--together/--apart", show_default="asks", help="Whether all robots begin each move together."),
    ] = None,
) -> None:
    """Write a scenario in which every robot with a base makes some moves."""
    _refuse_existing(file)
    question = "Moves of each robot: f0.5 is 0.5 m ahead, l90 is 90 degrees left"
    chosen = (moves or _ask(question, "f0.5 l90 f0.5 r90")).split()
    if not chosen or not all(map(_MOVE.fullmatch, chosen)):
        raise typer.BadParameter(f"must be commands such as f0.5 l90, not {moves!r}", param_hint="'--moves'")
    if together is None:
        together = _ask("Does each move begin at the same time on all robots? (y/n)", "y").lower().startswith("y")
    step = _TOGETHER if together else ""
    text = _SCENARIO.format(file=file.name, name=_name_of(file), moves=f"[{', '.join(chosen)}]", together=step)
    _write(file, "scenario", text, f"eal run {file} --fleet sim")


@app.command("world", cls=EalCommand)
def new_world(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="File to write.")] = Path("world.yaml"),
    size: Annotated[str | None, typer.Option(metavar="WIDTHxDEPTH", show_default="asks", help="Size in m.")] = None,
    obstacles: Annotated[
        int | None, typer.Option(min=0, max=50, show_default="asks", help="How many round obstacles.")
    ] = None,
) -> None:
    """Write a room with round obstacles for simulated robots."""
    _refuse_existing(file)
    answer = size or _ask("Size of the room in m", "6x4")
    least_m, most_m = _SIZE_M
    found = _SIZE.fullmatch(answer.strip())
    sides = [float(side) for side in found.groups()] if found is not None else []
    if not sides or not all(least_m <= side <= most_m for side in sides):
        why = f"must be such as 6x4, from {least_m:g} to {most_m:g} m, not {answer!r}"
        raise typer.BadParameter(why, param_hint="'--size'")
    width_m, depth_m = sides
    number = obstacles if obstacles is not None else _ask_number("How many obstacles", (0, 50))
    spots = _spots(width_m, depth_m)
    if number > len(spots):
        why = f"a room of {width_m:g} x {depth_m:g} m has space for {len(spots)}"
        raise typer.BadParameter(why, param_hint="'--obstacles'")
    lines = [f"  - {{kind: circle, x_m: {x_m:g}, y_m: {y_m:g}, radius_m: 0.15}}\n" for x_m, y_m in spots[:number]]
    listed = "obstacles:\n" + "".join(lines) if lines else ""
    text = _WORLD.format(file=file.name, name=_name_of(file), width_m=width_m, depth_m=depth_m, obstacles=listed)
    _write(file, "world", text, f"eal world {file} --save {file.with_suffix('.png')}")


def _spots(width_m: float, depth_m: float) -> list[tuple[float, float]]:
    """Return places for obstacles, far apart from each other and from the middle, the nearest to the middle first."""
    columns, rows = (math.floor((side_m / 2 - 0.5) / _SPACING_M) for side_m in (width_m, depth_m))
    places = [
        (column * _SPACING_M, row * _SPACING_M)
        for column in range(-columns, columns + 1)
        for row in range(-rows, rows + 1)
        if (column, row) != (0, 0)
    ]
    return sorted(places, key=lambda place: (math.hypot(*place), math.atan2(place[1], place[0])))


def _ask(question: str, default: str) -> str:
    """Return the answer of a person; the default where nobody can answer."""
    return str(typer.prompt(question, default=default, err=True)) if sys.stdin.isatty() else default


def _ask_number(question: str, limits: tuple[int, int]) -> int:
    answer = _ask(question, "3")
    least, most = limits
    if not (answer.isascii() and answer.isdigit() and least <= int(answer) <= most):
        raise typer.BadParameter(f"{question}: must be a number from {least} to {most}, not {answer!r}")
    return int(answer)


def _name_of(file: Path) -> str:
    if re.fullmatch(NAME_PATTERN, file.stem) is None:
        why = "its name is the name inside: it must be a letter (A-Z, a-z), then letters, digits, '_', '.' or '-'"
        raise file_error(file, why)
    return yaml.safe_dump(file.stem).splitlines()[0]  # with quotes for names such as `true`


def _refuse_existing(file: Path) -> None:
    if file.exists():
        raise file_error(file, "exists already; nothing was written")


def _write(file: Path, kind: str, text: str, *next_commands: str) -> None:
    """Write the file and check it; print what to do next."""
    with writing(file):
        file.write_text(header_for(file, kind) + text, encoding="utf-8")
    if problems := check_file(file).problems:
        raise ConfigError(problems)
    print_line(stdout(), str(file))
    for command in next_commands:
        print_line(stdout(), f"Next: {command}", "dim")
