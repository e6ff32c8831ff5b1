"""Only requested plugins are imported, and import errors are reported."""

from __future__ import annotations

import sys
from typing import Any

import pytest

from eal_actors.kernel.errors import PluginError
from eal_actors.managers.manifest import read_manifest
from eal_actors.managers.plugins import import_plugin
from tests.unit.managers.plugins.rig import Write, services


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
