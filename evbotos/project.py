"""This project's files in the layout of its wheel."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import eal_actors
from eal_actors.kernel.bundled import bundled_path
from evbotos.tree import SITE

_BUNDLED: Final = ("plugins", "fleets", "scenarios")
_LEFT_OUT: Final = ("__pycache__", "tests", "_bundled", "plugin_template")
_ENDINGS: Final = (".py", ".yaml", ".typed", ".json", ".html", ".css", ".js")


def project_files() -> Iterator[tuple[str, Path]]:
    """Yield the files that a robot needs: their path below site-packages, and their source."""
    package = Path(eal_actors.__file__).parent
    yield from _below(package, "eal_actors")
    for name in _BUNDLED:
        yield from _below(bundled_path(name), f"eal_actors/_bundled/{name}")


def _below(folder: Path, place: str) -> Iterator[tuple[str, Path]]:
    for path in sorted(folder.rglob("*")):
        inner = path.relative_to(folder)
        if any(part in _LEFT_OUT or part.startswith("test_") for part in inner.parts):
            continue
        if path.is_file() and path.suffix in _ENDINGS:
            yield f"{place}/{inner.as_posix()}", path


def install_project(root: Path) -> None:
    """Install the project into a tree, with the metadata of its version and entry points."""
    site = root / SITE
    for name, path in project_files():
        (site / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, site / name)
    version = eal_actors.__version__
    info = site / f"eal_actors-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: eal-actors\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(_entry_points())


def _entry_points() -> str:
    """Return the entry points of scenario steps, without those of development tools."""
    file = Path(eal_actors.__file__).parent.parent / "pyproject.toml"
    if not file.is_file():
        return ""
    groups = tomllib.loads(file.read_text())["project"].get("entry-points", {})
    lines = []
    for group, entries in groups.items():
        if group.startswith("eal_actors."):
            lines += [f"[{group}]", *(f"{name} = {target}" for name, target in entries.items())]
    return "\n".join([*lines, ""])
