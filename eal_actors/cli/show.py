"""`eal show`: the steps of a scenario as a tree."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text
from rich.tree import Tree

from eal_actors.cli.options import JsonOption, ScenarioArgument, SettingsOption, bad_option
from eal_actors.cli.output import print_line, stdout, write_json
from eal_actors.kernel.errors import writing
from eal_actors.recording.outline_picture import draw_outline
from eal_actors.scenario import load_scenario
from eal_actors.scenario.language.parameters import read_settings, with_parameters
from eal_actors.scenario.report.outline import outline

_STYLES = {"section": "dim", "role": "dim", "branch": "yellow", "on": "bold blue", "expect": "green"}


def show_scenario(
    scenario: ScenarioArgument,
    settings: SettingsOption = None,
    svg: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the tree as a picture.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Show the steps of a scenario as a tree, with their lines in the file; no fleet is needed."""
    loaded = load_scenario(scenario)
    with bad_option("--set"):
        loaded = with_parameters(loaded, read_settings(loaded.file, settings or ()))
    lines = list(outline(loaded))
    if svg is not None:
        with writing(svg):
            svg.write_text(draw_outline(lines), encoding="utf-8")
    if as_json:
        write_json([{"depth": one.depth, "kind": one.kind, "text": one.text, "line": one.line} for one in lines])
        return
    console = stdout()
    about = f": {loaded.file.description}" if loaded.file.description else ""
    tree = Tree(Text.assemble((loaded.name, "bold"), about), guide_style="dim")
    open_nodes = [tree]
    for line in lines:
        del open_nodes[line.depth + 1 :]
        text = Text.assemble((line.text, _STYLES.get(line.kind, "")), (f"  :{line.line}", "dim"))
        open_nodes.append(open_nodes[-1].add(text))
    console.print(tree)
    if svg is not None:
        print_line(console, f"svg: {svg}", "dim")
