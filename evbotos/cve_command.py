"""`evbotos cve`: known vulnerabilities of a built image, from database files, without a network."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from evbotos.build import OUTPUT
from evbotos.errors import BuildError
from evbotos.options import ImageArgument, JsonOption, OutputOption, PlatformArgument, built_folder
from evbotos.terminal import ExitCode, console, new_table, write_json
from evbotos.vulnerabilities import UNIMPORTANT, components_of, findings

_SHOWN: int = 70


def cve(
    platform: PlatformArgument,
    image: ImageArgument = "robot",
    database: Annotated[
        list[Path] | None,
        typer.Option("--database", "-d", help="JSON of Debian's security tracker, or OSV as JSON or zip; repeatable."),
    ] = None,
    output: OutputOption = OUTPUT,
    every: Annotated[bool, typer.Option("--all", help="Include those that Debian calls unimportant.")] = False,
    as_json: JsonOption = False,
) -> None:
    """List known vulnerabilities of a built image. The exit code is 1 if there are any.

    Get the databases once, where there is a network: https://security-tracker.debian.org/tracker/data/json for Debian's
    packages, and https://osv-vulnerabilities.storage.googleapis.com/PyPI/all.zip for Python's.
    """
    if not database:
        raise BuildError("name a database file: --database; `evbotos cve --help` says where to get one")
    components = components_of(built_folder(output, platform, image) / "sbom.cdx.json")
    known = sorted({one for file in database for one in findings(components, file)})
    shown = [one for one in known if every or one.urgency != UNIMPORTANT]
    if as_json:
        write_json({"components": len(components), "findings": [asdict(one) for one in shown]})
    else:
        table = new_table("package", "version", "vulnerability", "fixed in", "urgency", "what it is")
        for one in shown:
            about = one.description if len(one.description) <= _SHOWN else f"{one.description[:_SHOWN]}..."
            table.add_row(one.component.name, one.component.version, one.identifier, one.fixed, one.urgency, about)
        if shown:
            console().print(table)
        hidden = (
            f"; {len(known) - len(shown)} unimportant ones are not shown (--all)" if len(known) > len(shown) else ""
        )
        console().print(f"{len(components)} components, {len(shown)} vulnerabilities{hidden}", soft_wrap=True)
    if shown:
        raise typer.Exit(ExitCode.FAILED)
