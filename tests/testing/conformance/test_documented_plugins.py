"""The plugins of docs/plugins.md, taken from the page as they stand, pass every check."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from eal_actors.testing.conformance import Bench, run_checks, settings_of

PAGE: Final = (Path(__file__).parents[3] / "docs/plugins.md").read_text(encoding="utf-8")

TANK: Final = """

def connect():
    return EALPlugin("Base")


def disconnect(plugin):
    pass


def create_Base():
    return Base()


def destroy_Base(resource):
    pass
"""


def block(language: str, start: str) -> str:
    """Return the page's only code block of a language with such a beginning."""
    found = re.findall(rf"```{language}\n({re.escape(start)}.*?)```", PAGE, re.DOTALL)
    (text,) = found
    return str(text)


def check(folder: Path, manifest: str, code: str) -> dict[str, tuple[str, ...]]:
    """Write a plugin and return the problems of its checks."""
    folder.mkdir()
    (folder / "plugin.yaml").write_text(manifest, encoding="utf-8")
    (folder / "plugin.py").write_text(code, encoding="utf-8")
    results = list(run_checks(Bench(folder, settings_of({}))))
    assert {result.outcome for result in results} == {"ok", "failed", "skipped"} - {
        outcome for outcome in ("failed", "skipped") if outcome not in {result.outcome for result in results}
    }
    return {result.check.name: result.problems for result in results if result.outcome == "failed"}


def test_the_lift_conforms(tmp_path: Path) -> None:
    code = block("python", '"""A lift that takes its time')
    assert check(tmp_path / "lift", block("yaml", "# plugin.yaml"), code) == {}


def test_the_tank_conforms(tmp_path: Path) -> None:
    code = block("python", "import math\n\nfrom eal_actors.plugin import").partition("\nbase = Base()")[0]
    code = code.replace("import Activity, ", "import Activity, EALPlugin, ") + TANK
    manifest = 'version: 1\nname: tank\ndescription: A tank.\nplugin_version: "1"\nresources: [Base]\n'
    assert check(tmp_path / "tank", manifest, code) == {}
