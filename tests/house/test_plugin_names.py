"""The framework knows no plugin by name.

A name of a bundled plugin may not occur in the code of eal_actors as

- an import of `plugins.<name>` or `eal_plugins.<name>`,
- a text that equals it, or begins with it and `.`, `:` or `/`, as in `camera/plugin.yaml` or `sim://world`,
- a text that contains `plugins.<name>` or `plugins/<name>`.

Docstrings and comments are prose. Words of the field stay: some plugins have the name of a thing or of a command. WORDS
lists these texts, each with its file and its meaning.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NAMES = sorted(manifest.parent.name for manifest in (ROOT / "plugins").glob("*/plugin.yaml"))

WORDS = {
    ("cli/calibrate_camera.py", "camera"): "the command `eal calibrate camera`",
    ("cli/app.py", "replay"): "the command `eal replay`",
    ("cli/maps.py", "sim"): "the extra that maps need",
    ("cli/app.py", "tracker:app"): "the commands `eal tracker ...`",
    ("cli/app.py", "tracker"): "the commands `eal tracker ...`",
    ("cli/replay_service.py", "replay"): "the label of its bar",
    ("cli/records.py", "replay.yaml"): "the file that `eal replay` writes",
    ("managers/manifest.py", "camera"): "a kind of device",
    ("managers/shared_ports.py", "camera"): "a kind of device",
    ("operate/doctor/devices.py", "camera"): "a kind of device",
    ("recording/mcap_file.py", "camera"): "a key of the record: whose picture it is",
    ("recording/provenance.py", "system"): "a key of the record: the operating system",
}


def texts_of(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield the texts in code, with their lines; docstrings are none."""
    prose = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    prose |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings of attributes
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            yield node.lineno, node.value
        elif isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.lineno, f"{node.module}.{alias.name}") for alias in node.names)


def names_in(text: str) -> list[str]:
    """Return the plugins that a text names."""
    words = "|".join(map(re.escape, NAMES))
    return re.findall(rf"^({words})(?=$|[.:/])", text) + re.findall(rf"plugins[./]({words})\b", text)


@pytest.mark.parametrize("name", NAMES)
def test_the_rule_finds_a_name(name: str) -> None:
    for text in (name, f"{name}://world", f"plugins.{name}.emulator", f"the folder plugins/{name}"):
        assert name in names_in(text)
    assert not names_in(f"a word such as {name} in a sentence")


def test_the_framework_knows_no_plugin_by_name() -> None:
    found = {}
    for file in sorted((ROOT / "eal_actors").rglob("*.py")):
        place = str(file.relative_to(ROOT / "eal_actors"))
        for line, text in texts_of(ast.parse(file.read_text(encoding="utf-8"))):
            if names_in(text) and (place, text) not in WORDS:
                found[f"{place}:{line}"] = text
    assert not found


def test_every_exception_is_needed() -> None:
    for place, word in WORDS:
        tree = ast.parse((ROOT / "eal_actors" / place).read_text(encoding="utf-8"))
        assert word in {text for _, text in texts_of(tree)}, (place, word)
