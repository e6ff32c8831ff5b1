"""Plugins that use other plugins: importable first, and refused in a circle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from eal_actors.kernel.errors import PluginError
from eal_actors.managers.manifest import PluginManifest, discover, read_manifest
from eal_actors.managers.plugins import import_plugin
from tests.unit.managers.plugins.rig import unload

MANIFEST = """\
version: 1
name: {name}
description: A plugin of a test.
plugin_version: "1"
resources: [Thing]
uses: [{uses}]
requires: [{requires}]
"""

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Iterator[Write]:
    """Write a plugin's folder, with a `plugin.py` and a `part.py`; all are unloaded at the end."""
    folders: list[Path] = []

    def write_plugin(
        name: str, code: str = "", *, part: str = "", uses: str = "", requires: str = "", under: str = "plugins"
    ) -> Path:
        folder = tmp_path / under / name
        folder.mkdir(parents=True)
        (folder / "plugin.yaml").write_text(MANIFEST.format(name=name, uses=uses, requires=requires), encoding="utf-8")
        (folder / "plugin.py").write_text(code, encoding="utf-8")
        (folder / "part.py").write_text(part, encoding="utf-8")
        folders.append(folder)
        return folder

    yield write_plugin
    for folder in folders:
        unload(folder)


def found(tmp_path: Path, name: str) -> PluginManifest:
    manifests, errors = discover([tmp_path / "plugins"])
    assert not errors
    return manifests[name]


def test_a_plugin_imports_from_those_that_it_uses_and_they_from_theirs(write: Write, tmp_path: Path) -> None:
    write("a_user", "from ..b_middle.part import SUM\n", uses="b_middle")
    write(
        "b_middle",
        "raise AssertionError('only its parts are imported')",
        part="from ..c_low.part import ONE\nSUM = ONE + 1\n",
        uses="c_low",
    )
    write("c_low", part="ONE = 1\n")
    manifest = found(tmp_path, "a_user")
    assert [plugin.name for plugin in manifest.used()] == ["c_low", "b_middle"]
    assert import_plugin(manifest).SUM == 2


def test_a_manifest_read_alone_finds_its_neighbours_and_the_bundled_plugins(write: Write) -> None:
    write("z_near", part="HERE = True\n")
    folder = write("a_user", "from ..z_near.part import HERE\n", uses="z_near, sample")
    manifest = read_manifest(folder)
    assert [plugin.name for plugin in manifest.used()] == ["z_near", "sample"]
    assert import_plugin(manifest).HERE


def test_a_plugin_that_two_use_is_one(write: Write, tmp_path: Path) -> None:
    write("shared", part="class Kind:\n    pass\n")
    for name in ("one", "other"):
        write(name, "from ..shared.part import Kind\n", uses="shared")
    assert import_plugin(found(tmp_path, "one")).Kind is import_plugin(found(tmp_path, "other")).Kind


def test_a_plugin_that_is_used_and_is_not_there_is_named(write: Write, tmp_path: Path) -> None:
    write("user", uses="romba")
    with pytest.raises(PluginError, match=r"plugin 'user' uses another one: .*'romba'.*did you mean 'roomba'"):
        import_plugin(found(tmp_path, "user"))


@pytest.mark.parametrize(
    ("uses", "circle"), [(("a", None), "a -> a"), (("b", "a"), "a -> b -> a"), (("b", "b"), "b -> b")]
)
def test_a_circle_is_refused(write: Write, tmp_path: Path, uses: tuple[str, str | None], circle: str) -> None:
    for name, used in zip("ab", uses, strict=True):
        write(name, uses=used or "")
    with pytest.raises(PluginError, match=f"plugin 'a': plugins use one another in a circle: {circle}$"):
        import_plugin(found(tmp_path, "a"))


def test_what_a_used_plugin_requires_is_required(write: Write, tmp_path: Path) -> None:
    write("low", requires="no_such_module")
    write("user", uses="low", requires="math")
    manifest = found(tmp_path, "user")
    assert manifest.missing_modules() == ("no_such_module",)
    with pytest.raises(PluginError) as raised:
        import_plugin(manifest)
    assert str(raised.value) == (
        "plugin 'user' needs no_such_module for the plugin 'low', which it uses: pip install no_such_module"
    )


def test_a_used_plugin_that_cannot_be_told_from_another_of_its_name_is_refused(write: Write, tmp_path: Path) -> None:
    there = write("low", under="elsewhere")
    import_plugin(read_manifest(there))
    here = write("low")
    write("user", uses="low")
    with pytest.raises(PluginError, match=f"plugin 'user' uses the plugin 'low' in {here}, but another .* in {there}"):
        import_plugin(found(tmp_path, "user"))
