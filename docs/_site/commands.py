"""The directive `eal-commands`: every command of a program, as its `--help` tells of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.main import get_command

from eal_actors.cli import app as eal
from evbotos.cli import app as evbotos

_OPTION = re.compile(r"(?<![\w-])(--[a-z][a-z-]*)")
_EXAMPLES = ("eal ", "evbotos ")
PROGRAMS = {"eal": eal, "evbotos": evbotos}


def commands_markdown(program: str) -> str:
    """Return a section for each command, with its arguments and options."""
    return "\n\n".join(_sections(get_command(PROGRAMS[program]), program))


def _sections(command: Any, path: str) -> Iterator[str]:
    for name, sub in sorted(getattr(command, "commands", {}).items()):
        if getattr(sub, "hidden", False):
            continue
        if getattr(sub, "commands", None):
            yield from _sections(sub, f"{path} {name}")
        else:
            yield _section(sub, f"{path} {name}")


def _section(command: Any, path: str) -> str:
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    options = [one for one in command.params if one.param_type_name == "option" and not getattr(one, "hidden", False)]
    usage = " ".join([path, *(["[OPTIONS]"] if options else []), *(_metavar(one) for one in arguments)])
    lines = [f"## {path}", f"```text\n{usage}\n```", _marked((command.help or "").replace("\b", "").strip())]
    rows = [f"| `{_metavar(one)}` | {_help(one)} | |" for one in arguments]
    rows += [f"| {_names(one)} | {_help(one)} | {_default(one)} |" for one in options if one.name != "help"]
    if rows:
        lines.append("\n".join(["| | | if left out |", "|---|---|---|", *rows]))
    return "\n\n".join(lines)


def _metavar(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _names(option: Any) -> str:
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    return names if getattr(option, "is_flag", False) or not option.metavar else f"{names} `{option.metavar}`"


def _help(parameter: Any) -> str:
    return _marked((getattr(parameter, "help", None) or "").replace("|", "\\|").replace("<", "\\<"))


def _marked(text: str) -> str:
    """Return a help text with examples and options as code; what is code already stays."""
    return "\n".join(f"`{line}`" if line.startswith(_EXAMPLES) else _with_options(line) for line in text.splitlines())


def _with_options(line: str) -> str:
    parts = line.split("`")
    parts[0::2] = [_OPTION.sub(r"`\1`", part) for part in parts[0::2]]
    return "`".join(parts)


def _default(option: Any) -> str:
    shown = getattr(option, "show_default", None)
    if isinstance(shown, str):
        return shown
    if not shown or callable(option.default) or option.default in (None, False, ()) or getattr(option, "is_flag", 0):
        return ""
    return f"`{option.default}`"


class CommandsDirective(SphinxDirective):
    """`{eal-commands} eal`."""

    required_arguments = 1
    has_content: ClassVar[bool] = False

    def run(self) -> list[nodes.Node]:
        """Return the sections."""
        return self.parse_text_to_nodes(commands_markdown(self.arguments[0]), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive."""
    app.add_directive("eal-commands", CommandsDirective)
    return {"parallel_read_safe": True}
