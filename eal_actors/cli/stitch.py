"""`eal stitch`: a folder of frames becomes one seamless panorama."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import counted, new_table, short_path, stdout, write_json
from eal_actors.kernel.errors import ArgumentError, ConfigError, Problem, UnsupportedError

if TYPE_CHECKING:
    from eal_actors.lab.panorama import Panorama
    from eal_actors.lab.panorama.folder import Shots

_STYLES: Final = {"features": "green", "gradients": "green", "odometry only": "yellow"}
_MUCH_DEG: Final = 5.0
"""Beyond this, a ring that does not close says something of the field of view."""


def stitch_frames(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder of frames.", show_default=False)],
    field_of_view: Annotated[
        float,
        typer.Option(metavar="DEG", min=10, max=150, help="Angle between a frame's left and right edge, in degrees."),
    ] = 60.0,
    step: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            min=-180,
            max=180,
            show_default=False,
            help="How far the camera turned right from each frame to the next, in degrees; negative for left.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", show_default=False, help="The panorama, a .png or .jpg; FOLDER/panorama.png."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Stitch the frames that a camera took while it turned in place.

    Where the camera looked is read from yaws.csv or frames.csv (a column yaw_rad or yaw_deg, counter-clockwise, and a
    column file unless the rows are in the order of the files), or from the pose beside each frame (frame.0.json beside
    frame.0.png), as the panorama scenario saves it; or it is told with --step.
    The exit code is 1 if a frame had to be left out.
    """
    try:
        from eal_actors.lab.panorama.folder import PANORAMA, PICTURES, describe, read_shots, save_panorama
    except ImportError as error:
        raise UnsupportedError(f"stitching needs OpenCV ({error}): pip install 'eal-actors[vision]'") from None
    file = out or folder / PANORAMA
    if file.suffix.lower() not in PICTURES:
        raise typer.BadParameter(f"{str(file)!r} must end in {', '.join(PICTURES)}", param_hint="--out")
    shots = read_shots(folder, None if step is None else math.radians(step), [file])
    panorama = _stitched(folder, shots, field_of_view)
    save_panorama(panorama, file)
    report = {"file": str(file), **describe(panorama, shots)}
    if as_json:
        write_json(report)
    else:
        _print(report, field_of_view)
    if panorama.unplaced:
        raise typer.Exit(ExitCode.FAILED)


def _stitched(folder: Path, shots: Shots, field_of_view_deg: float) -> Panorama:
    from eal_actors.lab.panorama import stitch

    try:
        return stitch(shots.frames, shots.yaws_rad, math.radians(field_of_view_deg), names=shots.names)
    except ArgumentError as error:
        raise ConfigError([Problem(str(folder), 0, 0, "", error.message)]) from error


def _print(report: dict[str, Any], field_of_view_deg: float) -> None:
    console = stdout()
    table = new_table("frame", "odometry [°]", "yaw [°]", "gain", "placed by")
    for column in table.columns[1:4]:
        column.justify = "right"
    for frame in report["frames"]:
        name, told = Text(frame["file"]), f"{frame['odometry_deg']:z.1f}"
        if frame["left_out"]:
            table.add_row(name, told, "", "", Text(f"left out: {frame['left_out']}", style="red"))
        else:
            by = Text(frame["placed_by"], style=_STYLES[frame["placed_by"]])
            table.add_row(name, told, f"{frame['yaw_deg']:z.1f}", f"{frame['gain']:.2f}", by)
    console.print(table)
    console.print()
    for note in _notes(report, field_of_view_deg):
        console.print(Text(note, style="yellow"), soft_wrap=True)
    size = f"{report['width']} x {report['height']} px, {'all the way round' if report['is_full'] else _extent(report)}"
    console.print(
        Text.assemble(("panorama: ", "bold"), f"{short_path(Path(report['file']))}  ", (size, "dim")), soft_wrap=True
    )


def _extent(report: dict[str, Any]) -> str:
    return f"{report['width'] / report['columns_per_deg']:.0f}°"


def _notes(report: dict[str, Any], field_of_view_deg: float) -> list[str]:
    """Return what people should know besides."""
    notes = []
    left_out = sum(frame["left_out"] is not None for frame in report["frames"])
    if left_out:
        notes.append(f"{counted(left_out, 'frame')} of {len(report['frames'])} left out.")
    if report["missing_deg"] > 0.5:
        notes.append(f"No frame shows {report['missing_deg']:.0f}° of it, which are black.")
    error_deg = report["closing_error_deg"]
    if error_deg is not None and abs(error_deg) > _MUCH_DEG:
        likely_deg = field_of_view_deg * 360 / (360 + error_deg)
        notes.append(
            f"The turns add up to {360 + error_deg:.0f}°, not 360°: try --field-of-view {likely_deg:.0f}, "
            f"unless the odometry was as wrong."
        )
    return notes
