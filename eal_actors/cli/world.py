"""`eal world`: show the content of a world file as a table or a drawing."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, print_line, stdout, write_json
from eal_actors.device.world import CircleObstacle, Formation, WorldModel, load_world
from eal_actors.kernel.errors import writing
from eal_actors.recording import draw_world

_FORMATS: Final = (".pdf", ".png", ".svg")

_ObjectRow = tuple[str, str, str, str, str]


def show_world(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="World file, or the name of a bundled one.")],
    save: Annotated[
        Path | None, typer.Option(metavar="PICTURE", help="Draw a plan into this .png, .svg or .pdf file instead.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """List the objects of a world with their positions, and with the numbers used in messages and drawings."""
    world = load_world(file)
    if save is not None:
        _save_drawing(world, save)
    elif as_json:
        poses = [pose.model_dump() for pose in world.start_poses]
        write_json({**world.model_dump(mode="json"), "start_poses": poses})
    else:
        _print_objects(world)


def summarize_world(world: WorldModel) -> str:
    """Return a short description of a world: `8 x 6 m, 5 obstacles, 1 box`."""
    kinds = (
        ("obstacle", "obstacles", world.obstacles),
        ("box", "boxes", world.boxes),
        ("beacon", "beacons", world.beacons),
        ("drop", "drops", world.drops),
        ("poster", "posters", world.posters),
        ("lamp", "lamps", world.lighting.lamps),
        ("keep-out zone", "keep-out zones", world.keep_out),
        ("place", "places", world.places),
        ("start pose", "start poses", world.start_poses),
    )
    counts = [f"{len(things)} {one if len(things) == 1 else many}" for one, many, things in kinds if things]
    return ", ".join([_size(world.size_m), *(counts or ["empty"])])


def _save_drawing(world: WorldModel, picture: Path) -> None:
    if picture.suffix.lower() not in _FORMATS:
        raise typer.BadParameter(f"{str(picture)!r} must end in {', '.join(_FORMATS)}", param_hint="--save")
    with writing(picture):
        drawn = draw_world(world, picture)
    if drawn is None:
        raise typer.Exit(ExitCode.FAILED)
    print_line(stdout(), str(drawn))


def _print_objects(world: WorldModel) -> None:
    console = stdout()
    about = f"  {summarize_world(world)}; {world.height_m:g} m high, {world.lighting.ambient_lux:g} lux, "
    print_line(console, Text.assemble((world.name, "bold"), (f"{about}{world.physics.rate_hz:g} Hz", "dim")))
    rows = [*_obstacles(world), *_others(world), *_start_poses(world)]
    if not rows:
        return
    table = new_table("object", "x [m]", "y [m]", "yaw [°]", "", right=("x [m]", "y [m]", "yaw [°]"))
    for name, *rest in rows:
        table.add_row(Text(name, style="cyan"), *map(Text, rest))
    console.print()
    console.print(table)


def _obstacles(world: WorldModel) -> Iterator[_ObjectRow]:
    for number, (obstacle, solid) in enumerate(zip(world.obstacles, world.solid_obstacles, strict=True)):
        texture = f", {solid.texture}" if solid.texture else ""
        if isinstance(solid, CircleObstacle):
            extent, yaw = f"{2 * solid.radius_m:g} m across", ""
        else:
            extent, yaw = _size(solid.size_m), _rounded(solid.yaw_deg)
        about = f"{obstacle.kind}, {extent}, {solid.height_m:g} m high{texture}"
        yield f"obstacles[{number}]", _rounded(solid.x_m), _rounded(solid.y_m), yaw, about


def _others(world: WorldModel) -> Iterator[_ObjectRow]:
    for number, box in enumerate(world.boxes):
        about = f"{box.name}, {_size(box.size_m)}, {box.height_m:g} m high, {box.mass_kg:g} kg"
        yield f"boxes[{number}]", _rounded(box.x_m), _rounded(box.y_m), _rounded(box.yaw_deg), about
    for number, beacon in enumerate(world.beacons):
        red, green, blue = beacon.colour
        about = f"{beacon.name}, colour ({red}, {green}, {blue}), reaches {beacon.reach_m:g} m"
        yield f"beacons[{number}]", _rounded(beacon.x_m), _rounded(beacon.y_m), "", about
    for number, drop in enumerate(world.drops):
        yield f"drops[{number}]", _rounded(drop.x_m), _rounded(drop.y_m), _rounded(drop.yaw_deg), _size(drop.size_m)
    for number, poster in enumerate(world.posters):
        at, about = _rounded(poster.at_m), f"{poster.wall} wall, {_size(poster.size_m)}, {poster.texture}"
        is_along_x = poster.wall in ("north", "south")
        yield f"posters[{number}]", at if is_along_x else "", "" if is_along_x else at, "", about
    for number, lamp in enumerate(world.lighting.lamps):
        about = f"{lamp.z_m:g} m high, {lamp.lumens:g} lm"
        yield f"lighting.lamps[{number}]", _rounded(lamp.x_m), _rounded(lamp.y_m), "", about
    for number, zone in enumerate(world.keep_out):
        yield f"keep_out[{number}]", "", "", "", ", ".join(f"({_rounded(x)}, {_rounded(y)})" for x, y in zone)
    for name, place in world.places.items():
        yaw = "" if place.yaw_deg is None else _rounded(place.yaw_deg)
        yield f"places.{name}", _rounded(place.x_m), _rounded(place.y_m), yaw, ""


def _start_poses(world: WorldModel) -> Iterator[_ObjectRow]:
    if isinstance(world.starts, Formation):
        shape = world.starts
        about = f"{shape.shape} of {shape.count}, {shape.spacing_m:g} m apart"
        yield "starts", _rounded(shape.x_m), _rounded(shape.y_m), _rounded(shape.yaw_deg), about
        return
    for number, pose in enumerate(world.starts):
        yield f"starts[{number}]", _rounded(pose.x_m), _rounded(pose.y_m), _rounded(pose.yaw_deg), ""


def _size(size_m: tuple[float, float]) -> str:
    return f"{_rounded(size_m[0])} x {_rounded(size_m[1])} m"


def _rounded(number: float) -> str:
    return f"{round(number, 3):g}"
