"""Plugins are found by their manifests, without an import."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import jsonschema
import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.kernel.errors import ConfigError, PluginError
from eal_actors.kernel.yaml_source import load_yaml
from eal_actors.managers.config import manifest_schema
from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.managers.manifest import (
    EmulatorSection,
    discover,
    read_manifest,
    replaying_plugin,
    simulating_plugin,
)
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.plugin import PluginContext
from tests.unit.managers.plugins.rig import CODE, Write, services


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
        "[eal_actors.plugins]\nprobe = eal_test_package.probe\nghost = eal_test_package.ghost\ngone = eal_gone\n",
        encoding="utf-8",
    )
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    found, errors = discover([])
    assert found["probe"].folder == folder
    assert [error.message for error in errors] == [
        "entry point 'ghost' names 'eal_test_package.ghost', which holds no plugin.yaml",
        "entry point 'gone' names 'eal_gone', which is not installed (`pip install -e` cannot: use plugin_dirs)",
    ]


@pytest.mark.parametrize(
    "file", sorted(bundled_path("plugins").glob("*/plugin.yaml")), ids=lambda file: file.parent.name
)
def test_shipped_manifests_are_right_by_schema_and_hold(file: Path) -> None:
    jsonschema.validate(load_yaml(file).root, manifest_schema(), jsonschema.Draft202012Validator)
    assert read_manifest(file.parent).contradictions() == []


def test_a_former_name_is_answered_with_the_new_one(
    write: Write, manager: Callable[[], EALPluginManager], robot: Callable[[str], RobotConfig]
) -> None:
    write("probe", extra="former_names: {old_probe: 'probe: {kind: old}'}\n")
    (problem,), _ = manager().check(robot("{old_probe: {port: x}}"))
    assert problem.message == "the plugin 'old_probe' is now part of 'probe': write probe: {kind: old}"
    assert problem.line == 4


def test_the_settings_of_an_emulator_follow_its_address() -> None:
    section = EmulatorSection(settings={"host": "{host}", "port": "{port}", "url": "tcp://{address}"})
    assert section.driver_settings("127.0.0.1:99") == {"host": "127.0.0.1", "port": 99, "url": "tcp://127.0.0.1:99"}


def test_of_several_simulations_the_bundled_one_is_the_default(write: Write, tmp_path: Path) -> None:
    write("another", extra="simulation: {scheme: toy}\nreplays: true\n")
    assert simulating_plugin([tmp_path / "plugins"]).folder == bundled_path("plugins/sim")
    assert replaying_plugin([tmp_path / "plugins"]).folder == bundled_path("plugins/replay")


def test_a_port_belongs_to_the_plugin_that_declares_its_scheme(
    write: Write, manager: Callable[[], EALPluginManager]
) -> None:
    code = f"{CODE}\ndef open_port(context, url, model, emulate):\n    return url\n"
    write("another", code, extra="simulation: {scheme: toy}\n")
    context = PluginContext("bot", "driver", None, services())
    assert manager().open_port(context, "toy://world/x", "any", str) == "toy://world/x"  # type: ignore[comparison-overlap]
