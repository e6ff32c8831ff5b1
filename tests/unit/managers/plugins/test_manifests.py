"""Plugins are found by their manifests, without an import."""

from __future__ import annotations

from pathlib import Path

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, PluginError
from eal_actors.managers.manifest import discover, read_manifest
from tests.unit.managers.plugins.rig import Write


def test_a_manifest_says_all_about_a_plugin_without_its_code(write: Write) -> None:
    folder = write("probe", "raise SystemExit", extra="requires: [math, no_such_module]\n")
    manifest = read_manifest(folder)
    assert (manifest.name, manifest.folder, manifest.file.resources) == ("probe", folder, ("Thing",))
    assert manifest.file.plugin_version == "1.2"
    assert manifest.missing_modules() == ("no_such_module",)


@pytest.mark.parametrize(
    ("wrong", "place", "words"),
    [
        ("resources: []", ":5:12", "at least 1"),
        ("resources: [1]", ":5:13", "must be text"),
        ("resources: ['two words']", ":5:13", "is not a name"),
        ("resources: [Thing]\nresuorces: [Other]", ":6:1", "did you mean 'resources'"),
    ],
)
def test_a_wrong_manifest_is_refused_with_its_place(write: Write, wrong: str, place: str, words: str) -> None:
    file = write("probe") / "plugin.yaml"
    file.write_text(file.read_text().replace("resources: [Thing]", wrong), encoding="utf-8")
    with pytest.raises(ConfigError) as raised:
        read_manifest(file.parent)
    assert f"plugin.yaml{place}: " in str(raised.value)
    assert words in str(raised.value)


def test_the_bundled_plugins_are_always_found() -> None:
    found, errors = discover([])
    assert not errors
    folders = {folder.parent.name for folder in bundled_path("plugins").glob("*/plugin.yaml")}
    assert set(found) == folders >= {"sample", "sim"}


def test_an_earlier_folder_hides_a_plugin_of_the_same_name(write: Write, tmp_path: Path) -> None:
    first, second, own_sample = write("probe", under="a"), write("probe", under="b"), write("sample", under="b")
    found, _ = discover([tmp_path / "a", tmp_path / "b"])
    assert (found["probe"].folder, found["sample"].folder) == (first, own_sample)
    assert discover([tmp_path / "b", tmp_path / "a"])[0]["probe"].folder == second


def test_a_broken_manifest_and_a_missing_folder_are_reported_and_keep_nothing_else_out(
    write: Write, tmp_path: Path
) -> None:
    write("probe")
    (write("broken") / "plugin.yaml").write_text("version: 1\nname: broken\n", encoding="utf-8")
    found, errors = discover([tmp_path / "plugins", tmp_path / "nowhere"])
    assert "probe" in found
    assert "broken" not in found
    assert [type(error) for error in errors] == [ConfigError, PluginError]
    assert "description: is missing" in str(errors[0])
    assert str(tmp_path / "nowhere") in str(errors[1])


def test_plugins_of_installed_packages_are_found_by_their_entry_point(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write("probe", under="site/eal_test_package")
    (folder.parent / "__init__.py").touch()
    (folder / "__init__.py").write_text("raise RuntimeError('discovery must not import')", encoding="utf-8")
    metadata = tmp_path / "site" / "eal_test_package-1.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: eal-test-package\nVersion: 1\n", encoding="utf-8")
    (metadata / "entry_points.txt").write_text(
        "[eal_actors.plugins]\nprobe = eal_test_package.probe\nghost = eal_test_package.ghost\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    found, errors = discover([])
    assert found["probe"].folder == folder
    assert [error.message for error in errors] == [
        "entry point 'ghost' names 'eal_test_package.ghost', which holds no plugin.yaml"
    ]
