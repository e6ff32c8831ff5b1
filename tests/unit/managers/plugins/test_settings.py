"""A plugin's settings arrive checked; every wrong one is found with its place."""

from __future__ import annotations

from typing import Any

from eal_actors.managers.manifest import read_manifest
from eal_actors.managers.plugins import import_plugin
from eal_actors.plugin import EALPlugin
from tests.unit.managers.plugins.rig import CODE, Write, services

WITH_SETTINGS = """\
from eal_actors.plugin import EALPlugin, Field, PluginSettingsModel, Resource

class Settings(PluginSettingsModel):
    port: int = Field(ge=1)
    name: str = "none"

SEEN = []

def connect(context):
    SEEN.append((context.robot, context.instance, context.settings, context.plugin))
    return EALPlugin("Thing")

def disconnect(plugin): ...

def create_Thing(context):
    SEEN.append(context.plugin)
    return Resource()

def destroy_Thing(resource): ...
"""


def test_settings_arrive_checked(write: Write, manager: Any, robot: Any) -> None:
    folder = write("probe", WITH_SETTINGS)
    plugins = manager().connect(robot("{left: {plugin: probe, port: 7}}"), services())
    plugins.resources["Thing"].create()
    (name, instance, settings, no_plugin), plugin = import_plugin(read_manifest(folder)).SEEN
    assert (name, instance, settings.port, settings.name, no_plugin) == ("bot", "left", 7, "none", None)
    assert isinstance(plugin, EALPlugin)


def test_check_finds_every_wrong_setting_with_its_place_and_connects_nothing(
    write: Write, manager: Any, robot: Any
) -> None:
    folder = write("probe", WITH_SETTINGS)
    problems, broken = manager().check(robot("{probe: {port: 0, nmae: x}, sampel: {}}"))
    assert not broken
    assert [(p.line, p.column, p.path) for p in sorted(problems)] == [
        (4, 29, "robots.bot.plugins.probe.port"),
        (4, 32, "robots.bot.plugins.probe.nmae"),
        (4, 42, "robots.bot.plugins.sampel"),
    ]
    words = " ".join(problem.message for problem in problems)
    assert "at least 1" in words
    assert "did you mean 'name'" in words
    assert "did you mean 'sample'" in words
    assert import_plugin(read_manifest(folder)).SEEN == []


def test_check_tells_what_cannot_be_imported_apart(write: Write, manager: Any, robot: Any) -> None:
    write("probe", "1 / 0")
    problems, broken = manager().check(robot("{probe: {}, sample: {}}"))
    assert not problems
    assert [str(error) for error in broken] == [
        "bot: plugin 'probe' fails to import: ZeroDivisionError: division by zero (at probe/plugin.py:1)"
    ]


def test_settings_for_a_plugin_without_any_are_refused(write: Write, manager: Any, robot: Any) -> None:
    write("probe")
    problems, _ = manager().check(robot("{probe: {port: 1, name: x}}"))
    assert [problem.message for problem in problems] == ["plugin 'probe' has no settings"] * 2


def test_an_unknown_plugin_points_to_manifests_that_could_not_be_read(write: Write, manager: Any, robot: Any) -> None:
    (write("probe") / "plugin.yaml").write_text("version: 1\n", encoding="utf-8")
    problems, _ = manager().check(robot("{probe: {}}"))
    assert "could not be read" in problems[0].message


def test_settings_must_be_of_the_framework_s_kind(write: Write, manager: Any, robot: Any) -> None:
    write("probe", f"{CODE}\nclass Settings:\n    pass\n")
    _, broken = manager().check(robot("{probe: {}}"))
    assert "must extend PluginSettingsModel" in str(broken[0])
