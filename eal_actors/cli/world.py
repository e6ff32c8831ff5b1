"""`eal world`: what is in a world file, as a table or as a picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, stdout, write_json
from eal_actors.device.world import CircleObstacle, Formation, WorldModel, load_world
from eal_actors.kernel.errors import ConfigError, Problem
from eal_actors.recording import draw_world

_FORMATS: Final = (".pdf", ".png", ".svg")

_Row = tuple[str, str, str, str, str]


def show_world(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="The world file, or a shipped one by name.", show_default=False)
    ],
    save: Annotated[
        Path | None,
        typer.Option(
            metavar="PICTURE", show_default=False, help="Draw its plan into a .png, .svg or .pdf file instead."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show what is in a world and where, with the numbers that messages and pictures name it by."""
    world = load_world(file)
    if save is not None:
        _save(world, save)
    elif as_json:
        poses = [pose.model_dump() for pose in world.start_poses]
        write_json({**world.model_dump(mode="json"), "start_poses": poses})
    else:
        _print(world)


def contents(world: WorldModel) -> str:
    """Return what is in a world in few words: `8 x 6 m, 5 obstacles, 1 box`."""
    kinds = (
        ("obstacle", "obstacles", world.obstacles),
        ("box", "boxes", world.boxes),
        ("beacon", "beacons", world.beacons),
        ("drop", "drops", world.drops),
        ("poster", "posters", world.posters),
        ("lamp", "lamps", world.lighting.lamps),
        ("start pose", "start poses", world.start_poses),
    )
    counts = [f"{len(things)} {one if len(things) == 1 else many}" for one, many, things in kinds if things]
    return ", ".join([_size(world.size_m), *(counts or ["empty"])])


def _save(world: WorldModel, picture: Path) -> None:
    if picture.suffix.lower() not in _FORMATS:
        raise typer.BadParameter(f"{str(picture)!r} must end in {', '.join(_FORMATS)}", param_hint="--save")
    try:
        drawn = draw_world(world, picture)
    except OSError as error:
        raise ConfigError([Problem(str(picture), 0, 0, "", f"cannot be written: {error.strerror}")]) from error
    if drawn is None:
        raise typer.Exit(ExitCode.FAILED)
    stdout().print(Text(str(drawn)), soft_wrap=True)


def _print(world: WorldModel) -> None:
    console = stdout()
    about = f"  {contents(world)}; {world.height_m:g} m high, {world.lighting.ambient_lux:g} lux, "
    console.print(Text.assemble((world.name, "bold"), (f"{about}{world.physics.rate_hz:g} Hz", "dim")), soft_wrap=True)
    rows = [*_obstacles(world), *_others(world), *_starts(world)]
    if not rows:
        return
    table = new_table("what", "x [m]", "y [m]", "yaw [°]", "")
    for column in table.columns[1:4]:
        column.justify = "right"
    for what, *rest in rows:
        table.add_row(Text(what, style="cyan"), *map(Text, rest))
    console.print()
    console.print(table)


def _obstacles(world: WorldModel) -> Iterator[_Row]:
    for number, (obstacle, solid) in enumerate(zip(world.obstacles, world.solid_obstacles, strict=True)):
        texture = f", {solid.texture}" if solid.texture else ""
        if isinstance(solid, CircleObstacle):
            extent, yaw = f"{2 * solid.radius_m:g} m across", ""
        else:
            extent, yaw = _size(solid.size_m), _short(solid.yaw_deg)
        about = f"{obstacle.kind}, {extent}, {solid.height_m:g} m high{texture}"
        yield f"obstacles[{number}]", _short(solid.x_m), _short(solid.y_m), yaw, about


def _others(world: WorldModel) -> Iterator[_Row]:
    for number, box in enumerate(world.boxes):
        about = f"{box.name}, {_size(box.size_m)}, {box.height_m:g} m high, {box.mass_kg:g} kg"
        yield f"boxes[{number}]", _short(box.x_m), _short(box.y_m), _short(box.yaw_deg), about
    for number, beacon in enumerate(world.beacons):
        red, green, blue = beacon.colour
        about = f"{beacon.name}, colour ({red}, {green}, {blue}), reaches {beacon.reach_m:g} m"
        yield f"beacons[{number}]", _short(beacon.x_m), _short(beacon.y_m), "", about
    for number, drop in enumerate(world.drops):
        yield f"drops[{number}]", _short(drop.x_m), _short(drop.y_m), _short(drop.yaw_deg), _size(drop.size_m)
    for number, poster in enumerate(world.posters):
        at, about = _short(poster.at_m), f"{poster.wall} wall, {_size(poster.size_m)}, {poster.texture}"
        is_along_x = poster.wall in ("north", "south")
        yield f"posters[{number}]", at if is_along_x else "", "" if is_along_x else at, "", about
    for number, lamp in enumerate(world.lighting.lamps):
        about = f"{lamp.z_m:g} m high, {lamp.lumens:g} lm"
        yield f"lighting.lamps[{number}]", _short(lamp.x_m), _short(lamp.y_m), "", about


def _starts(world: WorldModel) -> Iterator[_Row]:
    if isinstance(world.starts, Formation):
        shape = world.starts
        about = f"{shape.shape} of {shape.count}, {shape.spacing_m:g} m apart"
        yield "starts", _short(shape.x_m), _short(shape.y_m), _short(shape.yaw_deg), about
        return
    for number, pose in enumerate(world.starts):
        yield f"starts[{number}]", _short(pose.x_m), _short(pose.y_m), _short(pose.yaw_deg), ""


def _size(size_m: tuple[float, float]) -> str:
    return f"{_short(size_m[0])} x {_short(size_m[1])} m"


def _short(number: float) -> str:
    return f"{round(number, 3):g}"
