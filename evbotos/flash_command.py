"""`evbotos flash`: write an image to a card or disk."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn, TransferSpeedColumn

from evbotos.block_devices import System, Target
from evbotos.disk_image import DiskImage, check_image
from evbotos.errors import FlashError
from evbotos.flash import Lost, Phase, Tell, opened, refusals, what_is_on, write_image
from evbotos.identity import image_with
from evbotos.options import JsonOption
from evbotos.terminal import console, new_table, write_json

_DOUBTED: Final = "It may contain a file system that this machine does not know."


def flash(
    image: Annotated[Path, typer.Argument(metavar="IMG", show_default=False, help="The image of a disk.")],
    device: Annotated[Path, typer.Argument(show_default=False, help="The whole disk, such as /dev/sdc.")],
    yes: Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")] = False,
    not_removable: Annotated[
        bool, typer.Option("--not-removable", help="Allow a fixed disk or a regular file.")
    ] = False,
    identity: Annotated[
        Path | None, typer.Option("--identity", show_default=False, help="A robot's identity of `evbotos provision`.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write an image to a card or disk, read it back and compare.

    Mounted, used, too small and system disks are refused. The data that will be lost is shown first.
    """
    check_image(image)
    with TemporaryDirectory(prefix="evbotos-flash-") as work:
        source = check_image(image if identity is None else image_with(identity, image, Path(work)))
        _flash(source, device, yes=yes, not_removable=not_removable, as_json=as_json)


def _flash(source: DiskImage, device: Path, *, yes: bool, not_removable: bool, as_json: bool) -> None:
    target = System().target(device)
    _require_allowed(source, target, not_removable)
    _show(source, target, what_is_on(target))
    if not yes:
        _ask(target)
    if System().target(device) != target:  # the medium may have changed during the prompt
        raise FlashError(f"{device} has changed: it is another medium or in use")
    try:
        with opened(target) as medium, _progress(source) as tell:
            flashed = write_image(source, medium, tell)
    except KeyboardInterrupt:
        console(error=True).print(
            f"Interrupted: {device} holds a part of the image and no partition table.", soft_wrap=True
        )
        raise
    if as_json:
        write_json({"image": str(source.path), "device": str(device), **dataclasses.asdict(flashed)})
    else:
        speed = flashed.size / 1e6 / max(flashed.write_s, 1e-9)
        console().print(
            f"{device} holds {source.path.name}: {flashed.size} bytes written in {flashed.write_s:.1f} s "
            f"({speed:.1f} MB/s) and verified in {flashed.check_s:.1f} s.",
            soft_wrap=True,
        )


def _require_allowed(source: DiskImage, target: Target, not_removable: bool) -> None:
    reasons = refusals(source, target, not_removable)
    if reasons:
        raise FlashError("\n".join([f"{target.path} is not written:", *(f"  {reason}" for reason in reasons)]))


def _show(source: DiskImage, target: Target, lost: list[Lost]) -> None:
    out = console(error=True)
    kind = "removable" if target.is_removable else "not removable"
    out.print(f"{target.path}: {target.model}, {_size(target.size)}, {kind}", style="bold", soft_wrap=True)
    if lost:
        table = new_table("will be lost", "size", "file system", "label")
        for part in lost:
            table.add_row(part.name, _size(part.size), part.kind or "unknown", part.label)
        out.print(table)
    else:
        out.print(f"It seems to be empty. {_DOUBTED}", soft_wrap=True)
    parts = f"{source.partitions} partition{'s' * (source.partitions != 1)}"
    out.print(f"It will be replaced by {source.path.name}: {_size(source.size)}, {parts}.", soft_wrap=True)


def _ask(target: Target) -> None:
    if not sys.stdin.isatty():
        raise FlashError(f"stdin is not a terminal: use --yes to overwrite {target.path}")
    if not typer.confirm(f"Overwrite {target.path}?", default=False, err=True):
        raise FlashError(f"{target.path} was not changed")


@contextmanager
def _progress(source: DiskImage) -> Iterator[Tell]:
    """Show a progress bar for each phase on a terminal, and a line per 10 % elsewhere."""
    out = console(error=True)
    if not out.is_terminal:
        yield _line_by_line(out, source.size)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, TimeRemainingColumn(), console=out) as bars:
        tasks = {phase: bars.add_task(phase, total=source.size, start=False) for phase in ("writing", "checking")}
        bars.start_task(tasks["writing"])

        def tell(phase: Phase, done: int) -> None:
            bars.start_task(tasks[phase])
            bars.update(tasks[phase], completed=done)

        yield tell


def _line_by_line(out: Console, size: int) -> Tell:
    told: dict[Phase, int] = {}

    def tell(phase: Phase, done: int) -> None:
        tenth = 10 * done // size
        if tenth > told.get(phase, 0):
            told[phase] = tenth
            out.print(f"{phase} {10 * tenth} %")

    return tell


def _size(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
