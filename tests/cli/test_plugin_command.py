"""`eal plugin`: list, new, check."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from eal_actors.kernel.bundled import bundled_path
from eal_actors.testing.conformance import CHECKS


def test_list_shows_what_there_is_and_what_is_broken(eal: Any, slides: Path, write: Any) -> None:
    write("plugins/broken/plugin.yaml", "version: 1\n")
    manifest = slides.parent / "plugins" / "slide" / "plugin.yaml"
    manifest.write_text(manifest.read_text(encoding="utf-8") + "requires: [no_such_module]\n", encoding="utf-8")
    result = eal("plugin", "list", "--dir", slides.parent / "plugins")
    assert result.exit_code == 0
    for word in ("sample", "0.1.0", "SampleResource", "slide", "missing: no_such_module"):
        assert word in result.stdout
    assert "broken: " in result.stderr
    assert "plugin.yaml:1:1: name: is missing" in result.stderr


def test_list_as_json(eal: Any, slides: Path) -> None:
    found = json.loads(eal("plugin", "list", "--dir", slides.parent / "plugins", "--json").stdout)
    assert found["broken"] == []
    slide = next(plugin for plugin in found["plugins"] if plugin["name"] == "slide")
    assert (slide["version"], slide["resources"], slide["missing"]) == ("0.1.0", ["Slide"], [])
    assert slide["folder"] == str(slides.parent / "plugins" / "slide")


NO_ROOM = """
import resource
from eal_actors.cli.app import main
resource.setrlimit(resource.RLIMIT_FSIZE, (200, resource.RLIM_INFINITY))
main()
"""


def test_new_on_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    """A limit of a file's size acts like a full disk. The part that was written kept a second attempt from writing."""
    result = subprocess.run(
        [sys.executable, "-c", NO_ROOM, "plugin", "new", "arm"],
        cwd=tmp_path,
        env={"PYTHONPATH": str(bundled_path(".")), "PATH": "", "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 2
    assert "plugins/arm: cannot be written: File too large" in result.stderr
    assert not list((tmp_path / "plugins").iterdir())


def test_new_writes_a_plugin_that_conforms_and_whose_own_test_passes(eal: Any, tmp_path: Path) -> None:
    result = eal("plugin", "new", "my_arm2", "--dir", tmp_path / "own")
    folder = tmp_path / "own" / "my_arm2"
    assert result.exit_code == 0
    names = ["README.md", "__init__.py", "plugin.py", "plugin.yaml", "pyproject.toml", "test_my_arm2.py"]
    assert sorted(file.name for file in folder.iterdir()) == names
    assert result.stdout.splitlines()[:6] == [str(folder / name) for name in names]
    assert "$" not in "".join(file.read_text(encoding="utf-8") for file in folder.iterdir())
    checked = eal("plugin", "check", folder)
    assert checked.exit_code == 0
    outcomes = [
        line.replace(check.name, "").split()[0] for line, check in zip(checked.stdout.splitlines(), CHECKS, strict=True)
    ]
    needs_an_emulator = [
        check.name in ("estimates its pose", "waits for its device", "survives unplugging") for check in CHECKS
    ]
    assert outcomes == ["skipped" if needs else "ok" for needs in needs_an_emulator]
    tests = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        cwd=tmp_path,
        env={"PYTHONPATH": str(bundled_path(".")), "PATH": "", "PYTHONDONTWRITEBYTECODE": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert tests.returncode == 0, tests.stdout
    assert f"{len(CHECKS) + 2} passed" in tests.stdout


def test_the_code_of_a_new_plugin_passes_the_project_s_linter(eal: Any, tmp_path: Path) -> None:
    eal("plugin", "new", "arm", "--dir", tmp_path)
    settings = ["--config", str(bundled_path("pyproject.toml"))]
    of_tests = ["--per-file-ignores", "test_*.py:D", "--per-file-ignores", "test_*.py:S101"]
    for command in (
        ["check", *settings, *of_tests, "--ignore", "I001", "arm"],  # first-party modules differ from folder to folder
        ["format", "--check", *settings, "arm"],
    ):
        ruff = [sys.executable, "-m", "ruff", *command, "--no-cache"]
        result = subprocess.run(ruff, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stdout + result.stderr


def test_new_overwrites_nothing(eal: Any, slides: Path) -> None:
    folder = slides.parent / "plugins" / "slide"
    (folder / "plugin.py").write_text("mine", encoding="utf-8")
    result = eal("plugin", "new", "slide", "--dir", folder.parent)
    assert result.exit_code == 2
    assert f"{folder}: exists already; nothing was written" in result.stderr
    assert (folder / "plugin.py").read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(
    "name", ["", "Arm", "my-arm", "2arm", "_arm", "arm_", "a__b", "../arm", "a.b", "class", "none", "resource", "ärm"]
)
def test_new_refuses_names_that_would_not_work(eal: Any, tmp_path: Path, name: str) -> None:
    result = eal("plugin", "new", name, "--dir", tmp_path / "own")
    assert result.exit_code == 2
    assert not (tmp_path / "own").exists()


@pytest.mark.slow
def test_check_tells_what_failed_and_why(eal: Any, slides: Path) -> None:
    folder = slides.parent / "plugins" / "slide"
    code = (folder / "plugin.py").read_text(encoding="utf-8")
    forgets = """    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, 0.3 if name == "speed_m_s" and name in self.__dict__ else value)

    def get_status"""
    (folder / "plugin.py").write_text(code.replace("    def get_status", forgets), encoding="utf-8")
    result = eal("plugin", "check", folder)
    assert result.exit_code == 1
    lines = result.stdout.splitlines()
    at = next(number for number, line in enumerate(lines) if line.startswith("keeps configuration"))
    assert lines[at].split() == ["keeps", "configuration", "FAILED"]
    assert lines[at + 1].startswith("    Slide: speed_m_s was EALData(double 0.1)")
    assert result.stderr == "1 check failed\n"
    found = json.loads(eal("plugin", "check", folder, "--json").stdout)["checks"]
    assert [check["check"] for check in found if check["outcome"] == "failed"] == ["keeps configuration"]


@pytest.mark.slow
def test_check_takes_settings_as_yaml(eal: Any) -> None:
    sim = bundled_path("plugins/sim")
    start = ["--setting", "start={x_m: 1, y_m: 0.5}"]
    found = json.loads(eal("plugin", "check", sim, "--setting", "model=roomba", *start, "--json").stdout)["checks"]
    assert found[0]["outcome"] == "ok"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ([], "settings: model: is missing"),
        (["model=car"], "settings: model: must be 'evbot2'"),
        (["model"], "must be KEY=VALUE, not 'model'"),
        (["=roomba"], "must be KEY=VALUE"),
        (["model={a"], "'model={a'"),
    ],
)
def test_check_refuses_wrong_settings(eal: Any, settings: list[str], words: str) -> None:
    options = [part for setting in settings for part in ("--setting", setting)]
    result = eal("plugin", "check", bundled_path("plugins/sim"), *options)
    assert result.exit_code == 2
    assert words in " ".join(result.stderr.split())


def test_check_takes_the_name_of_a_bundled_plugin(eal: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = eal("plugin", "check", "sample", "--json")
    assert result.exit_code == 0
    assert json.loads(result.stdout)["folder"] == str(bundled_path("plugins/sample"))


def test_check_of_no_plugin(eal: Any, tmp_path: Path) -> None:
    result = eal("plugin", "check", tmp_path)
    assert result.exit_code == 2
    assert "plugin.yaml: no such file" in result.stderr
    result = eal("plugin", "check", "smaple")
    assert result.exit_code == 2
    assert "smaple: no such folder, and no plugin of that name; did you mean 'sample'?" in result.stderr


def test_the_lines_of_the_checks_are_not_mixed_with_warnings() -> None:
    command = [sys.executable, "-u", "-m", "eal_actors", "plugin", "check", str(bundled_path("plugins/serial_port"))]
    done = subprocess.run(
        command, cwd=bundled_path("."), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stdout
    for line, check in zip(lines, CHECKS, strict=False):
        assert line.startswith(f"{check.name} ")
    assert "not ready" in "".join(lines[len(CHECKS) : -1])  # it was unplugged
    assert lines[-1].endswith("serial_port: conforms")
