"""The program `evbotos`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from eal_actors.kernel.clock import REAL_TIME
from eal_actors.kernel.errors import ConfigError, EALError, Problem
from evbotos.bench_command import bench, times
from evbotos.build import OUTPUT, Build
from evbotos.claim_command import claim
from evbotos.cve_command import cve
from evbotos.definitions import Definitions, fits, load_definitions
from evbotos.disk import parts_of
from evbotos.errors import BuildError
from evbotos.flash_command import flash
from evbotos.fleet_command import fleet_app
from evbotos.lock import read_lock
from evbotos.model import Image, Platform
from evbotos.options import ImageArgument, JsonOption, LocalOption, OutputOption, PlatformArgument, built_folder
from evbotos.plan import make_plan
from evbotos.provision_command import provision
from evbotos.run_command import run_image
from evbotos.sdk_command import sdk
from evbotos.slot_command import slot
from evbotos.terminal import EPILOG, ExitCode, console, new_table, report, write_json


class _Program(TyperGroup):
    """Maps errors to messages and exit codes, in this one place."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except EALError as error:
            raise typer.Exit(report(error)) from error
        except KeyboardInterrupt:
            raise typer.Exit(ExitCode.INTERRUPTED) from None


app = typer.Typer(
    name="evbotos",
    cls=_Program,
    help="Build, run and install small bootable images whose robots serve their resources.",
    epilog=EPILOG,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)

app.command("flash")(flash)
app.command("bench")(bench)
app.command("times")(times)
app.command("sdk")(sdk)
app.command("slot")(slot)
app.command("run")(run_image)
app.command("provision")(provision)
app.command("claim")(claim)
app.command("cve")(cve)
app.add_typer(fleet_app, name="fleet")


@app.command("list")
def list_definitions(local: LocalOption = None, as_json: JsonOption = False) -> None:
    """List platforms and images."""
    found = load_definitions(local)
    if as_json:
        write_json(
            {
                "platforms": {name: one.model_dump(mode="json") for name, one in found.platforms.items()},
                "images": {name: one.model_dump(mode="json") for name, one in found.images.items()},
            }
        )
        return
    table = new_table("platform", "architecture", "starts by", "what it is")
    for platform in found.platforms.values():
        table.add_row(platform.name, platform.architecture, platform.loader, platform.description)
    console().print(table)
    console().print()
    table = new_table("image", "for", "at most, with kernel", "RAM", "disk", "what it holds")
    for image in found.images.values():
        budget, memory = f"{image.budget_mb.root_with_kernel:g} MB", f"{image.budget_mb.memory or 0:g} MB"
        disk = f"{parts_of(image.layout).total >> 20} MiB"
        table.add_row(image.name, ", ".join(image.architectures) or "all", budget, memory, disk, image.description)
    console().print(table)


@app.command("check")
def check_definitions(local: LocalOption = None, as_json: JsonOption = False) -> None:
    """Check every definition, lock file and local.yaml; report all problems at once."""
    found = load_definitions(local)
    problems: list[Problem] = []
    plans = 0
    for platform in found.platforms.values():
        for image in (image for image in found.images.values() if fits(platform, image)):
            try:
                plan = make_plan(*found.chosen(platform.name, image.name), read_lock(found.lock_path(platform, image)))
            except ConfigError as error:
                problems += error.problems
                continue
            except BuildError as error:
                problems.append(Problem(f"platforms/{platform.name}.yaml", 0, 0, "", error.message))
                continue
            plans += 1
            if plan["locked_packages"] is not None and not plan["lock_is_current"]:
                message = "is older than the definitions; `evbotos build --update-lock` rewrites it"
                problems.append(Problem(found.lock_path(platform, image).name, 0, 0, "", message))
    if problems:
        raise ConfigError(set(problems))
    counts = {"platforms": len(found.platforms), "images": len(found.images), "plans": plans}
    if as_json:
        write_json(counts)
    else:
        console().print(f"{counts['platforms']} platforms, {counts['images']} images: no problems")


@app.command("plan")
def show_plan(
    platform: PlatformArgument,
    image: ImageArgument = "robot",
    local: LocalOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show every step, package, file and budget of a build, without building."""
    found, board, what = _chosen(platform, image, local)
    plan = make_plan(board, what, read_lock(found.lock_path(board, what)))
    if as_json:
        write_json(plan)
        return
    out = console()
    out.print(f"{board.name} {what.name}: {board.floor}", soft_wrap=True)
    for number, step in enumerate(plan["steps"], 1):
        out.print(f"{number}. {step}", soft_wrap=True)
    table = new_table("what", "")
    for key in ("packages", "locked_packages", "left_out_packages", "wheels", "locked_wheels", "services", "files"):
        table.add_row(key.replace("_", " "), ", ".join(plan[key]) if plan[key] is not None else "not locked yet")
    if plan["compiled_wheels"]:
        table.add_row("compiled wheels", ", ".join(plan["locked_compiled_wheels"] or plan["compiled_wheels"]))
    budget = plan["budget_mb"]
    table.add_row(
        "budget", f"{budget['root_with_kernel']:g} MB with kernel, runs in {budget['memory'] or '?'} MB of RAM"
    )
    table.add_row("disk", f"{plan['disk_mib']} MiB")
    table.add_row("missing tools", ", ".join(plan["missing_tools"]) or "none")
    out.print(table)


@app.command("build")
def build_image(
    platform: PlatformArgument,
    image: ImageArgument = "robot",
    local: LocalOption = None,
    output: OutputOption = OUTPUT,
    update_lock: Annotated[
        bool, typer.Option("--update-lock", help="Resolve the current versions and lock them.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Build an image. An interrupted build resumes; cached steps are reused."""
    found, board, what = _chosen(platform, image, local)
    start_s, progress = REAL_TIME.now(), console(error=True)

    def tell(words: str) -> None:
        progress.print(f"{REAL_TIME.now() - start_s:7.1f} s  {words}", soft_wrap=True)

    build = Build(board, what, found.local, found.lock_path(board, what), tell)
    try:
        built = build.run(output, update_lock=update_lock)
    except KeyboardInterrupt:
        tell(f"stopped: {len(build.runner.done)} of {len(build.runner.names)} steps are kept; the same command resumes")
        raise
    if as_json:
        write_json({"folder": str(built.folder), **built.report})
        return
    table = new_table("step", "seconds", "")
    for step in built.report["steps"]:
        table.add_row(step["name"], f"{step['seconds']:.1f}", "was there" if step["cached"] else "made")
    out = console()
    out.print(table)
    files = ", ".join(f"{name} {file['mb']:.1f} MB" for name, file in built.report["files"].items())
    total_mb, budget_mb = built.report["root_with_kernel_mb"], built.report["budget_mb"]
    out.print(f"{built.folder}: {files}; root and kernel {total_mb:.1f} MB of {budget_mb:g} MB", soft_wrap=True)


@app.command("size")
def show_sizes(
    platform: PlatformArgument,
    image: ImageArgument = "robot",
    output: OutputOption = OUTPUT,
    most: Annotated[int, typer.Option("--most", "-n", min=1, help="Rows to show.")] = 25,
    as_json: JsonOption = False,
) -> None:
    """Show the size of a built image by component."""
    folder = built_folder(output, platform, image)
    groups = json.loads((folder / "sizes.json").read_text())
    report_ = json.loads((folder / "manifest.json").read_text())
    if as_json:
        write_json({"files": report_["files"], "groups": groups})
        return
    table = new_table("part", "MB", "MB compressed, about")
    for group, (plain, packed) in list(groups.items())[:most]:
        table.add_row(group, f"{plain / 1e6:.2f}", f"{packed / 1e6:.2f}")
    rest = list(groups.values())[most:]
    table.add_row(
        f"{len(rest)} others", f"{sum(row[0] for row in rest) / 1e6:.2f}", f"{sum(row[1] for row in rest) / 1e6:.2f}"
    )
    out = console()
    out.print(table)
    for name, file in report_["files"].items():
        out.print(f"{name}: {file['mb']:.2f} MB")
    out.print(f"root and kernel: {report_['root_with_kernel_mb']:.2f} MB of {report_['budget_mb']:g} MB")
    out.print(f"disk: {round(report_['files']['disk.img']['mb'] * 1e6) >> 20} MiB with both slots")
    made = [step for step in report_["steps"] if not step["cached"]]
    seconds = sum(step["seconds"] for step in report_["steps"])
    out.print(f"last build: {seconds:.1f} s, for {len(made)} of {len(report_['steps'])} steps; the others were cached")


def _chosen(platform: str, image: str, local: Path | None) -> tuple[Definitions, Platform, Image]:
    found = load_definitions(local)
    return (found, *found.chosen(platform, image))


def main() -> None:
    """Run the program and exit."""
    app(prog_name="evbotos")
