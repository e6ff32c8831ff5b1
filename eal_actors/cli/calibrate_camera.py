"""`eal calibrate camera`: calibrate a camera's lens by pictures of a ChArUco board."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console

from eal_actors.cli.calibrate import app as calibrate_app
from eal_actors.cli.exit_codes import ExitCode
from eal_actors.cli.fleets import find_resource, plugin_advice, read_fleet
from eal_actors.cli.options import EalCommand, JsonOption, OptionalFleetOption
from eal_actors.cli.output import counted, print_line, stderr, stdout, write_json
from eal_actors.cli.tracker import SquareOption, SquaresOption, board_size
from eal_actors.cli.work import work_progress
from eal_actors.facade.fleet import Fleet
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ArgumentError, UnavailableError, file_error
from eal_actors.managers.fleet_model import FleetConfig
from eal_actors.managers.missing_modules import needs_extra

if TYPE_CHECKING:
    from eal_actors.lab.markers.lens_fit import BoardFinder, BoardView, LensFit

_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")
_PERIOD_S: Final = 0.4
app = calibrate_app


@app.command("camera", cls=EalCommand)
def calibrate_camera(
    folder: Annotated[Path | None, typer.Argument(metavar="FOLDER", help="Folder of pictures of the board.")] = None,
    fleet: OptionalFleetOption = None,
    robot: Annotated[str | None, typer.Option("--robot", "-r", help="Take the pictures with this robot.")] = None,
    resource: Annotated[str, typer.Option(help="Its camera.")] = "Camera",
    count: Annotated[int, typer.Option(min=8, max=200, help="Pictures to take, each of another view.")] = 25,
    timeout: Annotated[float, typer.Option(min=1, max=3600, help="Seconds in which to take them.")] = 300.0,
    squares: SquaresOption = "7x5",
    square: SquareOption = 38.0,
    write: Annotated[bool, typer.Option("--write", help="Write the lens into the fleet file.")] = False,
    camera: Annotated[
        str | None,
        typer.Option(
            metavar="[ROBOT.]CAMERA", show_default="the only one", help="The tracker's camera that gets the lens."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find a camera's focal lengths, centre and distortion, by pictures of a board of `eal tracker print --board`.

    Hold the board at different angles, near and far, so that it reaches into every corner of the picture. The result is
    the setting `lens` of the plugin tracker; --write replaces it in the fleet file, whose comments stay, or writes a
    file beside it and includes that. The exit code is 1, and nothing is written, if the error is over 1 pixel.
    """
    _check_sources(folder, robot, has_fleet=fleet is not None, needs_fleet=write or robot is not None)
    with needs_extra("vision", "markers need"):
        from eal_actors.lab.markers.lens_file import find_camera, write_lens
        from eal_actors.lab.markers.lens_fit import GOOD_ERROR_PX, BoardFinder, fit_lens
    config = read_fleet(fleet) if fleet is not None else None
    goal = find_camera(config, camera) if config is not None and write else None  # fails before pictures are taken
    finder = BoardFinder(board_size(squares, square))
    console = stderr() if as_json else stdout()
    if config is not None and robot is not None:
        found = _views_of_robot(config, (robot, resource), finder, count, timeout)
    else:
        found = _views_of_folder(folder or Path(), finder, console)
    try:
        fit = fit_lens(found)
    except ArgumentError as error:
        raise file_error(folder or fleet, error.message) from error
    is_good = fit.error_px <= GOOD_ERROR_PX
    note = f"Found by `eal calibrate camera`: error {fit.error_px:.2f} px."
    file = write_lens(config, goal, fit, note) if config and goal and is_good else None
    _print_fit(fit, len(found), file, as_json=as_json)
    _print_notes(console, fit, file)
    if not is_good:
        raise typer.Exit(ExitCode.FAILED)


def _check_sources(folder: Path | None, robot: str | None, *, has_fleet: bool, needs_fleet: bool) -> None:
    """Raise BadParameter unless the options name where the pictures come from."""
    if (folder is None) == (robot is None):
        raise typer.BadParameter("name either a folder of pictures, or --fleet and --robot", param_hint="'FOLDER'")
    if needs_fleet and not has_fleet:
        raise typer.BadParameter("is missing: name the fleet file", param_hint="'--fleet' / '-f'")


def _print_notes(console: Console, fit: LensFit, file: Path | None) -> None:
    """Print where the lens was written, and what is doubtful about it."""
    from eal_actors.lab.markers.lens_fit import GOOD_COVERAGE, GOOD_ERROR_PX

    if file is not None:
        print_line(console, f"The lens is in {short_path(file)}", "dim")
    if fit.coverage < GOOD_COVERAGE:
        text = f"The board was in {fit.coverage:.0%} of the picture: hold it into the corners too."
        print_line(console, text, "yellow")
    if fit.error_px > GOOD_ERROR_PX:
        print_line(console, "The error is too large: is the board flat, and are --squares and --square right?", "red")


def _print_fit(fit: LensFit, pictures: int, file: Path | None, *, as_json: bool) -> None:
    if as_json:
        write_json({"pictures": pictures, **asdict(fit), "file": str(file) if file else None})
        return
    console = stdout()
    console.out(fit.as_yaml(), end="", highlight=False)
    text = f"{counted(pictures, 'picture')}, error {fit.error_px:.2f} px, focal length ±{fit.focal_sd_px:.1f} px"
    print_line(console, text, "dim")


def _views_of_folder(folder: Path, finder: BoardFinder, console: Console) -> list[BoardView]:
    """Return the board in each picture of a folder, without pictures that do not show it."""
    import cv2
    import numpy as np

    files = sorted(file for file in folder.glob("*") if file.suffix.lower() in _SUFFIXES) if folder.is_dir() else []
    if not files:
        what = f"contains no pictures, which end in {', '.join(_SUFFIXES)}" if folder.is_dir() else "is no folder"
        raise file_error(folder, what)
    views, left_out = [], []
    with work_progress(stderr(), "picture", len(files)) as on_done:
        for file in files:
            if (image := cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) is None:
                raise file_error(file, "is not a picture that OpenCV can read")
            if (view := finder.find(np.asarray(image, np.uint8))) is not None:
                views.append(view)
            else:
                left_out.append(file.name)
            on_done(f"{file.name}: {'the board is found' if view is not None else 'no board'}", False)
    for name in left_out:
        print_line(console, f"{name}: left out, the board is not in it", "yellow")
    return views


def _views_of_robot(
    fleet: FleetConfig, camera: tuple[str, str], finder: BoardFinder, count: int, timeout_s: float
) -> list[BoardView]:
    """Take pictures until enough of them show the board at different places."""
    from eal_actors.lab.markers.lens_fit import is_new_view

    robot, resource = camera
    console = stderr()
    views: list[BoardView] = []
    with Fleet(fleet).connect([robot]) as opened, plugin_advice(opened):
        find_resource(opened, robot, resource)
        handle, end_s = opened[robot][resource], opened.clock.now() + timeout_s
        while len(views) < count:
            if opened.clock.now() > end_s:
                raise UnavailableError(
                    f"only {len(views)} of {count} views of the board came within {timeout_s:g} s: move the board, "
                    "or check --squares"
                ).at(robot, resource)
            view = finder.find(_as_image(handle.get_value().get().value, robot, resource))
            if view is not None and is_new_view(view, views):
                views.append(view)
                print_line(console, f"picture {len(views)} of {count}: move the board", "dim")
            opened.clock.sleep(_PERIOD_S)
    return views


def _as_image(value: Any, robot: str, resource: str) -> Any:
    """Return the picture of a camera's value: an array of RGB, or the bytes of a file."""
    import cv2
    import numpy as np

    if isinstance(value, np.ndarray) and value.ndim == 3:
        return cv2.cvtColor(value, cv2.COLOR_RGB2GRAY)
    file = bytes(value) if isinstance(value, bytes | np.ndarray) else b""
    image = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_GRAYSCALE) if file else None
    if image is None:
        raise ArgumentError("its value is no picture").at(robot, resource)
    return image
