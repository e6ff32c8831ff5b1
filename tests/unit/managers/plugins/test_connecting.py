"""Plugins connect, create, destroy and disconnect as they promised, or are left out."""

from __future__ import annotations

from typing import Any

import pytest

from eal_actors.kernel.errors import PluginError
from eal_actors.managers.manifest import read_manifest
from eal_actors.managers.plugins import import_plugin
from eal_actors.plugin import EALPlugin
from tests.unit.managers.plugins.rig import CODE, Write, services


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
        (
            ('LOG.append("connect")', "from eal_actors.plugin import PluginError; raise PluginError('no room')"),
            "bot: plugin 'probe': no room",
        ),
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


def test_eal_plugin_takes_the_count_of_the_thesis() -> None:
    assert EALPlugin(2, "A", "B", "C").list_resources() == ("A", "B")
    assert EALPlugin("A", "B").list_resources() == ("A", "B")


@pytest.mark.parametrize(("names", "words"), [((), "no resource"), ((0, "A"), "no resource"), (("A", "A"), "A twice")])
def test_eal_plugin_refuses_nothing_and_doubles(names: tuple[str | int, ...], words: str) -> None:
    with pytest.raises(PluginError, match=words):
        EALPlugin(*names)
