"""`eal audit`: what agents and the users of the dashboard commanded, and who decided about plans."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

from eal_actors.cli.options import JsonOption
from eal_actors.cli.output import new_table, stdout, write_json
from eal_actors.operate.audit import read_audit


def show_audit(
    runs_dir: Annotated[Path, typer.Option(help="The folder of runs of `eal dashboard` or `eal mcp`.")] = Path("runs"),
    last: Annotated[int, typer.Option(min=1, help="How many commands to show.")] = 50,
    as_json: JsonOption = False,
) -> None:
    """Show the commands of agents and of the dashboard's users: who, what, when, from where, and the outcome.

    Decisions about plans, refused commands and wrong tokens are shown too. A command without an outcome has not ended,
    or its end was lost with its process.
    """
    entries = read_audit(runs_dir)[-last:]
    if as_json:
        write_json({"commands": entries})
        return
    table = new_table("when", "who", "from", "what", "outcome")
    for entry in entries:
        when = datetime.fromisoformat(entry["at"]).astimezone().strftime("%Y-%m-%d %H:%M:%S")
        outcome = entry["outcome"] or "none yet"
        style = "green" if outcome == "ok" else "yellow" if entry["outcome"] is None else "red"
        what = " ".join((entry["command"], *_words(entry["arguments"])))
        table.add_row(when, Text(entry["who"], style="cyan"), entry["from"], Text(what), Text(outcome, style=style))
    stdout().print(table)


def _words(arguments: Mapping[str, Any]) -> list[str]:
    """Return the arguments in short; names and texts are clear without their keys."""
    given = {key: value for key, value in arguments.items() if value not in (None, {}, [])}
    return [value if isinstance(value, str) else f"{key}={value}" for key, value in given.items()]
