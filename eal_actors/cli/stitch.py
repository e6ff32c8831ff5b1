"""`eal stitch`: stitch a folder of frames into a panorama."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.text import Text

from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import counted, new_table, print_line, stderr, stdout, write_json
from eal_actors.cli.work import work_progress
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ArgumentError, file_error
from eal_actors.managers.missing_modules import needs_extra
from eal_actors.scenario.report.journal import EVENTS

if TYPE_CHECKING:
    from eal_actors.lab.panorama import Panorama
    from eal_actors.lab.panorama.folder import CameraFrames

_STYLES: Final = {"features": "green", "gradients": "green", "odometry only": "yellow"}
_MUCH_DEG: Final = 5.0  # a larger closing error suggests a wrong field of view


def stitch_frames(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER|RUN", help="Folder of frames, or of a run.")],
    field_of_view: Annotated[
        float,
        typer.Option(metavar="DEG", min=10, max=150, help="Angle between a frame's left and right edges, in degrees."),
    ] = 60.0,
    step: Annotated[
        float | None,
        typer.Option(
            metavar="DEG",
            min=-180,
            max=180,
            help="Turn of the camera to the right from each frame to the next, in degrees; negative for left.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The panorama, .png or .jpg; default: FOLDER/panorama.png.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Stitch the frames that a camera took while it turned in place.

    The yaw of each frame comes from yaws.csv or frames.csv: a column yaw_rad or yaw_deg, counter-clockwise, and a
    column file, which may be missing if the rows are in the order of the files. Without a table it comes from the pose
    beside each frame (frame.0.json beside frame.0.png), as the panorama scenario saves it; or from --step.
    In the folder of a run, the frames of each robot are stitched.
    The exit code is 1 if a frame was left out.
    """
    with needs_extra("vision", "stitching needs"):
        from eal_actors.lab.panorama.folder import PANORAMA, PICTURES, describe, read_frames, save_panorama
    if out is not None and out.suffix.lower() not in PICTURES:
        raise typer.BadParameter(f"{str(out)!r} must end in {', '.join(PICTURES)}", param_hint="--out")
    folders = _folders(folder, out)
    reports: dict[str, dict[str, Any]] = {}
    with work_progress(stderr(), "panorama", len(folders)) as on_done:
        for robot in folders:
            file = out or robot / PANORAMA
            frames = read_frames(robot, None if step is None else math.radians(step), [file])
            panorama = _stitch(robot, frames, field_of_view)
            save_panorama(panorama, file)
            reports[robot.name] = {"file": str(file), **describe(panorama, frames)}
            on_done(f"{robot.name}: {counted(len(frames.images), 'frame')}", False)
    if as_json:
        write_json(reports if (folder / EVENTS).is_file() else reports[folder.name])
    else:
        for report in reports.values():
            _print_report(report, field_of_view)
    if any(frame["left_out"] for report in reports.values() for frame in report["frames"]):
        raise typer.Exit(ExitCode.FAILED)


def _folders(folder: Path, out: Path | None) -> list[Path]:
    """Return the folder itself, or those of the robots of a run."""
    from eal_actors.lab.panorama.folder import folders_of_robots

    if not (folder / EVENTS).is_file():
        return [folder]
    folders = folders_of_robots(folder)
    if out is not None and len(folders) > 1:
        names = ", ".join(robot.name for robot in folders)
        raise typer.BadParameter(f"names one file, and the robots of the run are {names}", param_hint="--out")
    return folders


def _stitch(folder: Path, frames: CameraFrames, field_of_view_deg: float) -> Panorama:
    from eal_actors.lab.panorama import stitch

    try:
        return stitch(frames.images, frames.yaws_rad, math.radians(field_of_view_deg), names=frames.names)
    except ArgumentError as error:
        raise file_error(folder, error.message) from error


def _print_report(report: dict[str, Any], field_of_view_deg: float) -> None:
    console = stdout()
    numbers = ("odometry [°]", "yaw [°]", "gain")
    table = new_table("frame", *numbers, "placed by", right=numbers)
    for frame in report["frames"]:
        name, odometry = Text(frame["file"]), f"{frame['odometry_deg']:z.1f}"
        if frame["left_out"]:
            table.add_row(name, odometry, "", "", Text(f"left out: {frame['left_out']}", style="red"))
        else:
            by = Text(frame["placed_by"], style=_STYLES[frame["placed_by"]])
            table.add_row(name, odometry, f"{frame['yaw_deg']:z.1f}", f"{frame['gain']:.2f}", by)
    console.print(table)
    console.print()
    for note in _notes(report, field_of_view_deg):
        print_line(console, note, "yellow")
    extent_deg = 360.0 if report["is_full"] else report["width"] / report["columns_per_deg"]
    size = f"{report['width']} x {report['height']} px, {extent_deg:.0f}°"
    print_line(console, Text.assemble(("panorama: ", "bold"), f"{short_path(Path(report['file']))}  ", (size, "dim")))


def _notes(report: dict[str, Any], field_of_view_deg: float) -> list[str]:
    notes = []
    left_out = sum(frame["left_out"] is not None for frame in report["frames"])
    if left_out:
        notes.append(f"{counted(left_out, 'frame')} of {len(report['frames'])} left out.")
    if report["missing_deg"] > 0.5:
        notes.append(f"No frame shows {report['missing_deg']:.0f}° of the panorama: they are black.")
    error_deg = report["closing_error_deg"]
    if error_deg is not None and abs(error_deg) > _MUCH_DEG:
        likely_deg = field_of_view_deg * 360 / (360 + error_deg)
        notes.append(
            f"The turns add up to {360 + error_deg:.0f}°, not 360°: try --field-of-view {likely_deg:.0f}, "
            f"unless the odometry has this error."
        )
    return notes
