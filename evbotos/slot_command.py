"""`evbotos slot`: sign a built image as an update for a robot's other slot."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from evbotos.build import OUTPUT
from evbotos.options import ImageArgument, JsonOption, OutputOption, PlatformArgument, built_folder
from evbotos.terminal import console, write_json
from evbotos.update import write_update

UPDATE = "update.tar"


def slot(
    platform: PlatformArgument,
    image: ImageArgument = "robot",
    key: Annotated[
        Path, typer.Option("--key", help="Your private key (ed25519, PEM); robots verify updates with its public key.")
    ] = Path("update.pem"),
    output: OutputOption = OUTPUT,
    as_json: JsonOption = False,
) -> None:
    """Sign a built image as an update. On the robot, `evbotos-update install` writes it to the other slot."""
    folder = built_folder(output, platform, image)
    out = folder / UPDATE
    signed = write_update(folder, key, out)
    if as_json:
        write_json({"file": str(out), **signed})
        return
    console().print(f"{out}: {out.stat().st_size / 1e6:.1f} MB, {image} {signed['version']} for {platform}")
    console().print(f"Install it: ssh root@ROBOT evbotos-update install - < {shlex.quote(str(out))}", soft_wrap=True)
