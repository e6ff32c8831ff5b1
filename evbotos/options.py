"""Arguments and options that several commands share, and the folder of a built image."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from evbotos.errors import BuildError

PlatformArgument = Annotated[str, typer.Argument(metavar="PLATFORM", help="The board: see `evbotos list`.")]
ImageArgument = Annotated[str, typer.Argument(metavar="[IMAGE]", help="The image: see `evbotos list`.")]
LocalOption = Annotated[
    Path | None, typer.Option("--local", help="Your settings; they override others.", show_default="local.yaml")
]
OutputOption = Annotated[Path, typer.Option("--output", "-o", help="Output folder of builds.")]
JsonOption = Annotated[bool, typer.Option("--json", help="Write JSON.")]


def built_folder(output: Path, platform: str, image: str) -> Path:
    """Return the folder of a built image; raise BuildError if it is not built."""
    folder = output / f"{platform}-{image}"
    if not (folder / "manifest.json").is_file():
        raise BuildError(f"{folder} is not built; run `evbotos build {platform} {image}`")
    return folder
