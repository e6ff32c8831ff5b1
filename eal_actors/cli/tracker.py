"""`eal tracker`: prints for the plugin `tracker`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from eal_actors.cli.options import EalCommand, EalCommandGroup, bad_option
from eal_actors.cli.output import counted, print_line, stdout
from eal_actors.kernel.bundled import short_path
from eal_actors.kernel.errors import ArgumentError, writing
from eal_actors.managers.missing_modules import needs_extra

if TYPE_CHECKING:
    from eal_actors.lab.markers.prints import BoardSize

app = typer.Typer(cls=EalCommandGroup, help="Print markers and boards for trackers.", no_args_is_help=True)

PaperOption = Annotated[str, typer.Option("--paper", metavar="a4|a3|letter", help="Size of the paper.")]
SquaresOption = Annotated[
    str, typer.Option("--squares", metavar="COLUMNSxROWS", help="Squares of the board along its sides.")
]
SquareOption = Annotated[
    float, typer.Option("--square", metavar="MM", min=5, max=500, help="Side of a square of the board, in mm.")
]


@app.command("print", cls=EalCommand)
def print_markers(
    out: Annotated[Path, typer.Argument(metavar="FILE", help="File to write, .pdf or .svg.")],
    ids: Annotated[
        str | None, typer.Option("--ids", metavar="LIST", help="Numbers of markers, such as 1-6,40.")
    ] = None,
    family: Annotated[str, typer.Option(metavar="4x4_50|36h11", help="Family of the markers.")] = "4x4_50",
    size: Annotated[float, typer.Option(metavar="MM", min=5, max=1000, help="Side of the black square, in mm.")] = 120,
    board: Annotated[
        bool, typer.Option("--board", help="The ChArUco board for `eal calibrate camera` instead.")
    ] = False,
    squares: SquaresOption = "7x5",
    square: SquareOption = 38.0,
    paper: PaperOption = "a4",
) -> None:
    """Write markers, or the board for the calibration of cameras, to scale.

    Print at 100 %, and check the line of 100 mm on each sheet. A marker needs its white border.
    """
    if out.suffix.lower() not in (".pdf", ".svg"):
        raise typer.BadParameter("use a name that ends in .pdf or .svg", param_hint="'FILE'")
    if board == (ids is not None):
        raise typer.BadParameter("use either --ids or --board", param_hint="'--ids'")
    with needs_extra("vision", "markers need"):
        from eal_actors.device.markers import FAMILIES
        from eal_actors.lab.markers.prints import board_sheet, marker_sheets
        from eal_actors.lab.markers.sheet import PAPERS_MM, as_pdf, as_svg
    paper_mm = _choice("--paper", paper, PAPERS_MM)
    name: Any = family
    _choice("--family", family, FAMILIES)
    try:
        if ids is None:
            sheets = [board_sheet(board_size(squares, square), paper_mm)]
        else:
            sheets = marker_sheets(parse_ids(ids), name, size, paper_mm)
    except ArgumentError as error:
        raise typer.BadParameter(error.message) from error
    if out.suffix.lower() == ".svg" and len(sheets) > 1:
        raise typer.BadParameter(
            f"{len(sheets)} sheets, and an SVG file has one: write a .pdf file", param_hint="'FILE'"
        )
    data = as_pdf(sheets) if out.suffix.lower() == ".pdf" else as_svg(sheets[0]).encode()
    with writing(out):
        out.write_bytes(data)
    print_line(stdout(), f"{short_path(out)}: {counted(len(sheets), 'sheet')}, print at 100 %")


def parse_ids(text: str) -> list[int]:
    """Return the numbers of a list such as `1-6,40`."""
    found: list[int] = []
    for part in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,6})(?:-(\d{1,6}))?\s*", part)
        if match is None or (match[2] is not None and int(match[2]) < int(match[1])):
            raise typer.BadParameter(f"{part.strip()!r}: use numbers and ranges, such as 1-6,40", param_hint="'--ids'")
        found += range(int(match[1]), min(int(match[2] or match[1]), 10**4) + 1)
    return list(dict.fromkeys(found))


def board_size(squares: str, square_mm: float) -> BoardSize:
    """Return the board of the options `--squares` and `--square`."""
    from eal_actors.lab.markers.prints import BoardSize

    if (match := re.fullmatch(r"(\d{1,2})x(\d{1,2})", squares)) is None:
        raise typer.BadParameter(f"{squares!r}: use two numbers, such as 7x5", param_hint="'--squares'")
    with bad_option("--squares"):
        return BoardSize(int(match[1]), int(match[2]), square_mm / 1000)


def _choice(option: str, name: str, choices: Any) -> Any:
    if name not in choices:
        raise typer.BadParameter(f"{name!r}: use {', '.join(choices)}", param_hint=f"'{option}'")
    return choices[name]
