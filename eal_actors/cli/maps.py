"""`eal map`: the occupancy grid of a world, a map file or a run, and a path on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import typer

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import find_resource, plugin_advice, read_fleet
from eal_actors.cli.options import JsonOption, OptionalFleetOption
from eal_actors.cli.output import print_line, stdout, write_json
from eal_actors.cli.records import reading_run
from eal_actors.device.world import WorldModel, load_world
from eal_actors.facade.fleet import Fleet
from eal_actors.facade.traffic.positions import radius_m_of
from eal_actors.kernel.bundled import find_file
from eal_actors.kernel.errors import PlaceNotFoundError, writing
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.missing_modules import needs_extra
from eal_actors.recording import kept_world

if TYPE_CHECKING:
    from eal_actors.device.navigation.grid import OccupancyGrid
    from eal_actors.device.navigation.planner import PlannedPath

_PICTURES: Final = (".pdf", ".png", ".svg")
_RADIUS_M: Final = 0.2
_MAPS: Final = (".yaml", ".yml")


class _Source(NamedTuple):
    """A map without inflation, and the world that it belongs to."""

    name: str
    grid: OccupancyGrid
    world: WorldModel | None
    is_drawn: bool
    """Whether the things of the world are drawn over the map."""


def show_map(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="WORLD|MAP|RUN",
            help="World file or the name of a bundled one, map file of map_server or Nav2, or the folder of a run.",
        ),
    ],
    plan: Annotated[
        tuple[str, str] | None,
        typer.Option(metavar="FROM TO", help="Plan a path between places, or points such as 1.5,-2."),
    ] = None,
    radius_m: Annotated[
        float | None, typer.Option(metavar="M", min=0, help="Radius of the robot, with its distance; default: 0.2.")
    ] = None,
    robot: Annotated[
        str | None, typer.Option(metavar="NAME", help="Robot of --fleet: its own radius, and 5 cm.")
    ] = None,
    fleet: OptionalFleetOption = None,
    resolution_m: Annotated[
        float, typer.Option(metavar="M", min=0.005, help="Size of a cell; a map file has its own.")
    ] = 0.05,
    save: Annotated[
        Path,
        typer.Option(metavar="FILE", help="A .png, .svg or .pdf picture; or a .yaml map file with a .pgm picture."),
    ] = Path("map.png"),
    as_json: JsonOption = False,
) -> None:
    """Draw the map of a world, a map file or a run, and a path on it.

    A run's map is built from the scans of its robots at their estimated poses. Paths avoid obstacles, unknown floor and
    keep-out zones by the robot's radius. With --json, the path and the map's size are printed, and nothing is drawn.
    """
    if save.suffix.lower() not in (*_PICTURES, *_MAPS):
        raise typer.BadParameter(f"{str(save)!r} must end in {', '.join((*_PICTURES, *_MAPS))}", param_hint="--save")
    source = _load(file, resolution_m)
    inflated = source.grid.inflated(_radius_m(radius_m, robot, fleet))
    path = _plan(inflated, source.world, plan) if plan else None
    if as_json:
        write_json(_described(source, path))
        return
    _save(source, inflated, path, save)
    if plan and path:
        print_line(stdout(), f"{plan[0]} to {plan[1]}: {path.length_m:.2f} m, {len(path.points_m)} points")


def _load(file: Path, resolution_m: float) -> _Source:
    with needs_extra("sim", "maps need"):
        from eal_actors.device.navigation.map_file import load_map
        from eal_actors.device.navigation.world_grid import grid_from_world
        from eal_actors.recording.run_map import map_of_run
    if file.is_dir():
        with reading_run():
            return _Source(file.name, map_of_run(file, resolution_m), kept_world(file), False)
    path = find_file(file, "world")
    if {"image", "resolution"} & load_yaml(path).root.keys():
        return _Source(path.stem, load_map(path), None, False)
    world = load_world(path)
    return _Source(world.name, grid_from_world(world, resolution_m), world, True)


def _radius_m(given_m: float | None, robot: str | None, fleet: Path | None) -> float:
    """Return the distance to keep from obstacles; a robot tells its own radius."""
    if robot is None:
        return _RADIUS_M if given_m is None else given_m
    if fleet is None or given_m is not None:
        raise typer.BadParameter("needs --fleet, and no --radius-m", param_hint="--robot")
    from eal_actors.device.navigation.floor import WALL_MARGIN_M

    with Fleet(read_fleet(fleet, [robot])) as opened, plugin_advice(opened):
        find_resource(opened, robot, "Base")
        return radius_m_of(opened[robot]) + WALL_MARGIN_M


def _plan(grid: OccupancyGrid, world: WorldModel | None, ends: tuple[str, str]) -> PlannedPath:
    from eal_actors.device.navigation.planner import plan_path

    start, goal = (_point(world, text) for text in ends)
    return plan_path(grid, start, goal)


def _point(world: WorldModel | None, text: str) -> tuple[float, float]:
    """Return the point of a text such as `1.5,-2`, or of a place's name."""
    x, comma, y = text.partition(",")
    if comma:
        try:
            return float(x), float(y)
        except ValueError:
            message = f"{text!r} is no point; write x,y in metres: 1.5,-2"
            raise typer.BadParameter(message, param_hint="--plan") from None
    if world is None:
        raise PlaceNotFoundError(f"no place {text!r}: a map file has none; write x,y in metres: 1.5,-2")
    place = world.place(text)
    return place.x_m, place.y_m


def _described(source: _Source, path: PlannedPath | None) -> dict[str, Any]:
    grid = source.grid
    rows, columns = grid.cells.shape
    unknown, blocked = int((grid.cells < 0).sum()), int(grid.blocked.sum())
    return {
        "name": source.name,
        "rows": rows,
        "columns": columns,
        "resolution_m": grid.resolution_m,
        "origin": grid.origin._asdict(),
        "cells": {"free": rows * columns - blocked, "occupied": blocked - unknown, "unknown": unknown},
        "places": {name: place.model_dump() for name, place in source.world.places.items()} if source.world else {},
        "path": None if path is None else {"length_m": path.length_m, "points_m": path.points_m},
    }


def _save(source: _Source, inflated: OccupancyGrid, path: PlannedPath | None, file: Path) -> None:
    from eal_actors.device.navigation.map_file import save_map
    from eal_actors.recording.map_picture import draw_map

    with writing(file):
        if file.suffix.lower() in _MAPS:
            for written in save_map(source.grid, file):
                print_line(stdout(), str(written))
            return
        rows, columns = source.grid.cells.shape
        size = f"{columns * source.grid.resolution_m:g} x {rows * source.grid.resolution_m:g} m"
        title = f"{source.name}: {size}, cells of {source.grid.resolution_m:g} m"
        places = {name: (place.x_m, place.y_m) for name, place in source.world.places.items()} if source.world else {}
        world, points = source.world if source.is_drawn else None, path.points_m if path else ()
        drawn = draw_map(inflated, file, title=title, path=points, places=places, world=world)
    if drawn is None:
        raise typer.Exit(ExitCode.FAILED)
    print_line(stdout(), str(drawn))
