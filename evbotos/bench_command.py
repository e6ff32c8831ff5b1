"""`evbotos bench` and `evbotos times`: the tables of the thesis's chapter 5, extended by current results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from evbotos.bench import (
    BOARDS,
    BUILD_TIMES_S,
    OPERATIONS,
    THESIS_N,
    Benchmark,
    Engine,
    default_program,
    run_here,
)
from evbotos.bench_chart import draw_chart
from evbotos.bench_image import run_in_image
from evbotos.build import OUTPUT
from evbotos.definitions import load_definitions
from evbotos.errors import BuildError
from evbotos.options import JsonOption, OutputOption, built_folder
from evbotos.terminal import console, new_table, write_json

_QEMU_MEMORY_MB: Final = 256


def bench(
    engine: Annotated[Engine, typer.Option(help="What computes.")] = "octave",
    n: Annotated[int, typer.Option("--n", min=10, max=20_000, help="Rows and columns of the matrix.")] = THESIS_N,
    in_image: Annotated[
        bool, typer.Option("--in-image", help="Boot the octave image in QEMU and run the benchmark there.")
    ] = False,
    platform: Annotated[str, typer.Option(help="With --in-image: the board.")] = "qemu-amd64",
    program: Annotated[
        str | None, typer.Option(help="The program that runs it.", show_default="octave-cli, or this Python")
    ] = None,
    memory_mb: Annotated[int, typer.Option("--memory-mb", min=32, help="With --in-image: RAM.")] = _QEMU_MEMORY_MB,
    timeout_s: Annotated[float, typer.Option("--timeout-s", min=1, help="Give up after that.")] = 3600,
    output: OutputOption = OUTPUT,
    chart: Annotated[
        Path | None, typer.Option(help="Draw a chart, .svg or .png.", show_default="bench-ENGINE-N.svg in the output")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run the thesis's eight matrix operations and compare them with its three boards.

    Every result is verified. The output folder receives the measurements as JSON and as a chart.
    """
    if in_image:
        folder = built_folder(output, platform, "octave")
        board = load_definitions().platform(platform)
        measured = run_in_image(board, folder, engine, n, memory_mb, timeout_s)
    else:
        measured = run_here(engine, n, program or default_program(engine), timeout_s)
    name = f"bench-{engine}-{n}{f'-{platform}' if in_image else ''}"
    output.mkdir(parents=True, exist_ok=True)
    kept = output / f"{name}.json"
    kept.write_text(json.dumps(measured.as_json(), indent=1) + "\n")
    picture = chart or output / f"{name}.svg"
    draw_chart(measured, picture)
    if as_json:
        write_json(measured.as_json())
        return
    _show(measured)
    console().print(f"{kept}, {picture}", soft_wrap=True)


def _show(measured: Benchmark) -> None:
    out = console()
    out.print(f"{measured.engine} on {measured.where}, n = {measured.n}", style="bold", soft_wrap=True)
    same = measured.n == THESIS_N
    last = ["times faster than the BeagleBoard"] if same else []
    table = new_table("seconds", *BOARDS, "here", *last)
    for index, (operation, words) in enumerate(OPERATIONS.items()):
        then = [times[index] for times in BOARDS.values()]
        table.add_row(words, *map(_seconds, then), *_compared(measured.seconds[operation], then[-1], same))
    totals = [sum(times) for times in BOARDS.values()]
    table.add_row("total", *map(_seconds, totals), *_compared(measured.total_s, totals[-1], same))
    out.print(table)
    if not same:
        out.print(f"The boards' times are for n = {THESIS_N} and not comparable.")


def _seconds(seconds: float) -> str:
    return f"{seconds:.2f}"


def _compared(seconds: float, then: float, same: bool) -> list[str]:
    here = f"{seconds:.3f}" if seconds < 10 else _seconds(seconds)
    return [here, f"{then / max(seconds, 1e-9):.0f}"] if same else [here]


def times(output: OutputOption = OUTPUT, as_json: JsonOption = False) -> None:
    """Show the duration of each step of the last builds, next to the thesis's table 5.1."""
    builds = [json.loads(path.read_text()) for path in sorted(output.glob("*/manifest.json"))]
    if as_json:
        rows = [{key: build[key] for key in ("platform", "image", "steps")} for build in builds]
        write_json({"builds": rows, "thesis": {name: list(seconds) for name, seconds in BUILD_TIMES_S.items()}})
        return
    if not builds:
        raise BuildError(f"nothing is built in {output}; run `evbotos build`")
    steps = list(dict.fromkeys(step["name"] for build in builds for step in build["steps"]))
    table = new_table("platform", "image", *steps, "total")
    for build in builds:
        found = {step["name"]: step for step in build["steps"]}
        cells = [_step(found[name]) if name in found else "" for name in steps]
        table.add_row(build["platform"], build["image"], *cells, _total(build["steps"]))
    out = console()
    out.print("Seconds that each step took when it was made; those in brackets were made by an earlier build.")
    out.print(table)
    out.print()
    table = new_table("the thesis's base image (table 5.1)", "two 3.00 GHz cores", "eight 2.66 GHz cores")
    for name, seconds in BUILD_TIMES_S.items():
        table.add_row(name, *map(_clock, seconds))
    out.print(table)


def _total(steps: list[dict[str, Any]]) -> str:
    return f"{sum(step.get('made_s') or step['seconds'] for step in steps):.1f}"


def _step(step: dict[str, object]) -> str:
    if not step["cached"]:
        return f"{step['seconds']}"
    return f"({step['made_s']})" if step.get("made_s") is not None else "(unknown)"


def _clock(seconds: int) -> str:
    return f"{seconds // 3600}:{seconds // 60 % 60:02}:{seconds % 60:02}"
