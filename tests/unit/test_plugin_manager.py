"""EALPluginManager and the manifests: found without an import, imported in order, connected as promised."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eal_actors.bundled import bundled_path
from eal_actors.clock import ManualClock
from eal_actors.errors import ConfigError, PluginError
from eal_actors.managers.config import EALConfigManager
from eal_actors.managers.fleet_model import RobotConfig
from eal_actors.managers.manifest import discover, read_manifest
from eal_actors.managers.plugins import EALPluginManager, forget_plugin, import_plugin
from eal_actors.plugin import EALPlugin, FleetServices

MANIFEST = """\
version: 1
name: {name}
description: A plugin of a test.
plugin_version: "1.2"
resources: [{resources}]
"""

CODE = """\
from eal_actors.plugin import EALPlugin, Resource

LOG = []

class Thing(Resource):
    def get_value(self):
        return 1

def connect():
    LOG.append("connect")
    return EALPlugin("Thing")

def disconnect(plugin):
    LOG.append("disconnect")

def create_Thing():
    return Thing()

def destroy_Thing(resource):
    LOG.append("destroy")
"""

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write a plugin's folder."""

    def write_plugin(
        name: str, code: str = CODE, *, resources: str = "Thing", under: str = "plugins", extra: str = ""
    ) -> Path:
        folder = tmp_path / under / name
        folder.mkdir(parents=True)
        text = MANIFEST.format(name=name, resources=resources) + extra
        (folder / "plugin.yaml").write_text(text, encoding="utf-8")
        (folder / "plugin.py").write_text(code, encoding="utf-8")
        return folder

    return write_plugin


@pytest.fixture
def manager(tmp_path: Path) -> Callable[[], EALPluginManager]:
    return lambda: EALPluginManager([tmp_path / "plugins"])


@pytest.fixture
def robot(tmp_path: Path) -> Callable[[str], RobotConfig]:
    """Return a robot with the plugins given as in a fleet file."""

    def make(plugins: str) -> RobotConfig:
        file = tmp_path / "fleet.yaml"
        file.write_text(f"version: 1\nrobots:\n  bot:\n    plugins: {plugins}\n", encoding="utf-8")
        return EALConfigManager.load(file, environment={}).fleet.robots["bot"]

    return make


def services() -> FleetServices:
    return FleetServices(ManualClock())


# Manifests.


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


# Imports.


def test_only_what_is_asked_for_is_imported(write: Write, manager: Any, robot: Any) -> None:
    write("probe")
    write("bystander", "raise RuntimeError('not asked for')")
    plugins = manager().connect(robot("{probe: {}}"), services())
    assert list(plugins.resources) == ["Thing"]
    assert not plugins.errors


def test_a_plugin_imports_its_neighbours(write: Write, manager: Any) -> None:
    folder = write("probe", "from .parts.motor import GEAR\n")
    (folder / "parts").mkdir()
    (folder / "parts" / "motor.py").write_text("from ..protocol import BAUD\nGEAR = BAUD * 2\n", encoding="utf-8")
    (folder / "protocol.py").write_text("BAUD = 100\n", encoding="utf-8")
    assert import_plugin(manager().manifests["probe"]).GEAR == 200
    assert "protocol" not in sys.modules


def test_plugins_of_the_same_name_in_two_folders_are_two_modules(write: Write) -> None:
    one, other = (read_manifest(write("twin", f"WHERE = {place!r}", under=place)) for place in ("a", "b"))
    assert (import_plugin(one).WHERE, import_plugin(other).WHERE) == ("a", "b")
    assert import_plugin(one) is import_plugin(one)


def test_a_plugin_that_was_forgotten_is_read_again(write: Write) -> None:
    folder = write("changing", "from .part import VERSION")
    (folder / "part.py").write_text("VERSION = 'first'", encoding="utf-8")
    manifest = read_manifest(folder)
    assert import_plugin(manifest).VERSION == "first"
    (folder / "part.py").write_text("VERSION = 'the second'", encoding="utf-8")
    assert import_plugin(manifest).VERSION == "first"
    forget_plugin(manifest)
    assert import_plugin(manifest).VERSION == "the second"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("1 / 0", "fails to import: ZeroDivisionError: division by zero"),
        ("def (", "fails to import: SyntaxError"),
        ("raise SystemExit(3)", "fails to import: SystemExit: 3"),
        ("import no_such_module_at_all", "No module named 'no_such_module_at_all'"),
    ],
)
def test_what_goes_wrong_in_an_import_becomes_a_plugin_error(write: Write, code: str, words: str) -> None:
    with pytest.raises(PluginError, match="plugin 'probe'") as raised:
        import_plugin(read_manifest(write("probe", code)))
    assert words in str(raised.value)
    assert raised.value.__cause__ is not None


@pytest.mark.parametrize(
    ("extra", "remedy"), [("", "pip install no_such_module"), ("extra: sim\n", "pip install 'eal-actors[sim]'")]
)
def test_missing_modules_are_named_with_the_remedy(write: Write, extra: str, remedy: str) -> None:
    folder = write("probe", "raise AssertionError", extra=f"requires: [math, no_such_module]\n{extra}")
    with pytest.raises(PluginError) as raised:
        import_plugin(read_manifest(folder))
    assert str(raised.value) == f"plugin 'probe' needs no_such_module: {remedy}"


def test_a_folder_without_plugin_py_is_no_plugin(write: Write) -> None:
    folder = write("probe")
    (folder / "plugin.py").unlink()
    with pytest.raises(PluginError, match=r"has no plugin\.py"):
        import_plugin(read_manifest(folder))


# Settings.

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
        "bot: plugin 'probe' fails to import: ZeroDivisionError: division by zero"
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


# Connecting.


def test_connect_create_destroy_and_disconnect_go_in_order(write: Write, manager: Any, robot: Any) -> None:
    folder = write("probe")
    plugins = manager().connect(robot("{probe: {}}"), services())
    offer = plugins.resources["Thing"]
    resource = offer.create()
    assert resource is not offer.create()
    assert resource.get_value() == 1
    offer.destroy(resource)
    plugins.close()
    assert import_plugin(read_manifest(folder)).LOG == ["connect", "destroy", "disconnect"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("def connect():", "def connect_it():"), "lacks the function connect()"),
        (("def disconnect(", "def disconnect_it("), "lacks the function disconnect()"),
        (("def create_Thing(", "def create_thing("), "lacks the function create_Thing()"),
        (("def destroy_Thing(", "def destroy_thing("), "lacks the function destroy_Thing()"),
        (('LOG.append("connect")', "1 / 0"), "connect raised ZeroDivisionError"),
        (('LOG.append("connect")', "raise SystemExit"), "connect raised SystemExit"),
        (('return EALPlugin("Thing")', "return 5"), "connect returned 5, which is no EALPlugin"),
        (('EALPlugin("Thing")', 'EALPlugin("Thing", "More")'), "names Thing, but connect names More, Thing"),
        (('EALPlugin("Thing")', 'EALPlugin(2, "Thing")'), "promised 2 resources, but only 1"),
    ],
)
def test_a_plugin_that_breaks_its_promise_is_left_out_and_the_others_connect(
    write: Write, manager: Any, robot: Any, change: tuple[str, str], words: str
) -> None:
    assert change[0] in CODE
    write("probe", CODE.replace(*change))
    plugins = manager().connect(robot("{probe: {}, sample: {}}"), services())
    assert list(plugins.resources) == ["SampleResource"]
    (error,) = plugins.errors
    assert isinstance(error, PluginError)
    assert str(error).startswith("bot: ")
    assert words in str(error)


def test_settings_may_leave_out_resources(write: Write, manager: Any, robot: Any) -> None:
    code = CODE.replace("def connect(", "class Settings(PluginSettingsModel):\n    pass\n\n\ndef connect(", 1)
    write("probe", "from eal_actors.plugin import PluginSettingsModel\n" + code, resources="Thing, Another")
    plugins = manager().connect(robot("{probe: {}}"), services())
    assert list(plugins.resources) == ["Thing"]
    assert plugins.errors == ()


def test_create_must_return_a_resource(write: Write, manager: Any, robot: Any) -> None:
    write("probe", CODE.replace("return Thing()", "return 'a thing'"))
    plugins = manager().connect(robot("{probe: {}}"), services())
    with pytest.raises(PluginError, match="create_Thing returned 'a thing', which is no Resource"):
        plugins.resources["Thing"].create()


def test_resources_of_the_same_name_are_both_renamed(write: Write, manager: Any, robot: Any) -> None:
    two = CODE.replace('EALPlugin("Thing")', 'EALPlugin("Thing", "Own")') + (
        "\ncreate_Own, destroy_Own = create_Thing, destroy_Thing\n"
    )
    write("probe", two, resources="Thing, Own")
    for instances in (
        "{left: {plugin: probe}, right: {plugin: probe}}",
        "{right: {plugin: probe}, left: {plugin: probe}}",
    ):
        plugins = manager().connect(robot(instances), services())
        assert set(plugins.resources) == {"left.Thing", "left.Own", "right.Thing", "right.Own"}
    write("third")
    plugins = manager().connect(robot("{probe: {}, third: {}}"), services())
    assert set(plugins.resources) == {"probe.Thing", "Own", "third.Thing"}


def test_plugins_are_disconnected_in_reverse_and_a_failing_one_keeps_no_other(
    write: Write, manager: Any, robot: Any
) -> None:
    first = write("first")
    write("second", CODE.replace('LOG.append("disconnect")', "raise OSError('line is busy')"))
    plugins = manager().connect(robot("{first: {}, second: {}}"), services())
    with pytest.raises(PluginError, match="disconnect failed in second: OSError: line is busy"):
        plugins.close()
    assert import_plugin(read_manifest(first)).LOG == ["connect", "disconnect"]


# EALPlugin.


def test_eal_plugin_takes_the_count_of_the_thesis() -> None:
    assert EALPlugin(2, "A", "B", "C").list_resources() == ("A", "B")
    assert EALPlugin("A", "B").list_resources() == ("A", "B")


@pytest.mark.parametrize(("names", "words"), [((), "no resource"), ((0, "A"), "no resource"), (("A", "A"), "A twice")])
def test_eal_plugin_refuses_nothing_and_doubles(names: tuple[str | int, ...], words: str) -> None:
    with pytest.raises(PluginError, match=words):
        EALPlugin(*names)
