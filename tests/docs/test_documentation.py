"""The documentation is correct: commands and code run, files are valid, tables match the program."""

from __future__ import annotations

import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from eal_actors import Fleet
from eal_actors.cli.exit_codes import report_error
from eal_actors.cli.options import GlobalOptions
from eal_actors.device.world import load_world
from eal_actors.kernel import errors
from eal_actors.kernel.bundled import bundled_names
from eal_actors.managers.config import EALConfigManager
from eal_actors.scenario import check_scenario
from tests.docs import examples
from tests.facade.test_eal import SEVENTEEN
from tests.patience import patient_fleet
from tests.problems import problems_of

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs/tutorials").glob("*.md"))
"""Those are done whole, by test_tutorials.py."""
PAGES = [
    *(ROOT / f"{name}.md" for name in ("README", "DESIGN", "SECURITY")),
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in TUTORIALS),
    *ROOT.glob("plugins/*/README.md"),
]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

pytestmark = pytest.mark.docs


def blocks(language: str) -> list[tuple[str, str]]:
    """Return the code blocks of a language, each with a name for the test."""
    found = []
    for page in PAGES:
        for match in BLOCK.finditer(page.read_text()):
            if match.group(1) == language:
                line = page.read_text()[: match.start()].count("\n") + 1
                found.append((f"{page.relative_to(ROOT)}:{line}", match.group(2)))
    return found


LONG = ("scenarios/relay.yaml", "scenarios/search.yaml", "scenarios/formation.yaml", "patrol-visit.yaml", "ballet")
"""Scenarios that compute a minute; tests/scenarios has short forms of them, and `make demo` runs the ballet."""


def commands() -> list[object]:
    lines = [line.partition("#")[0].strip() for _, block in blocks("sh") for line in block.splitlines()]
    return [
        pytest.param(line, marks=pytest.mark.slow) if any(name in line for name in LONG) else line
        for line in dict.fromkeys(lines)
        if line
    ]


def environment() -> dict[str, str]:
    scripts = sysconfig.get_path("scripts")
    return {**os.environ, "PATH": f"{scripts}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT), "NO_COLOR": "1"}


def named(found: list[tuple[str, str]]) -> list[object]:
    return [pytest.param(block, id=name) for name, block in found]


@pytest.mark.timeout(900)
@pytest.mark.parametrize("command", commands())
def test_every_command_runs(command: str, tmp_path: Path) -> None:
    words = shlex.split(command)
    if words[:2] == ["make", "test"]:
        words.insert(1, "--dry-run")  # it is what runs this test
    if words[:2] == ["eal", "run"]:
        words += ["--rate", "max", "--runs-dir", str(tmp_path)]  # all are simulated: a busy machine changes nothing
    names_file = words[0] != "eal" or any((ROOT / word).exists() for word in words[1:])
    folder = ROOT if names_file else tmp_path  # a command that names no file of the checkout runs anywhere
    done = subprocess.run(words, cwd=folder, env=environment(), capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("code", named(blocks("python")))
def test_every_python_block_runs(code: str, tmp_path: Path) -> None:
    folder = ROOT if "fleets/" in code or "scenarios/" in code else tmp_path
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment(), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("text", named([block for block in blocks("yaml") if block[1].startswith("version: 1\nname:")]))
def test_every_yaml_block_is_a_valid_file(text: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "fleets" / "worlds", tmp_path / "worlds")
    (tmp_path / "common.yaml").write_text("version: 1\n")
    (tmp_path / "my_plugins").mkdir()
    assert_valid(text, tmp_path / "example.yaml")


@pytest.mark.parametrize("example", sorted(examples.FOLDER.glob("*.yaml")), ids=lambda file: file.name)
def test_every_example_file_is_valid_alone_in_a_folder(example: Path, tmp_path: Path) -> None:
    assert_valid(example.read_text(), tmp_path / example.name)


def assert_valid(text: str, file: Path) -> None:
    file.write_text(text)
    read = load_world if "\nsize_m:" in text else EALConfigManager.load
    problems = check_scenario(file) if "\nsteps:" in text else problems_of(lambda: read(file))
    assert not problems, "\n".join(map(str, problems))


def test_the_examples_are_what_the_pages_show_and_the_tests_run() -> None:
    texts = {file.relative_to(ROOT).as_posix(): file.read_text() for file in examples.FOLDER.glob("*.[py]*")}
    pages = {name: text for page in examples.PAGES for name, text in examples.shown(page).items()}
    assert pages == texts, "python -m tests.docs.examples puts them into the pages"
    listed = re.findall(r"^\| \[\S+\]\((\S+)\)", (examples.FOLDER / "index.md").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(Path(name).name for name in texts)


def test_an_example_hides_no_module_of_another_in_its_folder() -> None:
    """Python looks for modules in the folder of the program first: `concurrent.py` there broke every example."""
    names = {file.stem for file in examples.FOLDER.glob("*.py")}
    assert not names & {*sys.stdlib_module_names, "eal_actors", "numpy", "pytest", "yaml"}


def test_an_example_that_has_changed_is_put_into_its_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("A\n\n<!-- docs/examples/together.py -->\n```python\nold = 1\n```\n\nB\n")
    assert examples.update(page)
    assert (
        page.read_text() == f"A\n\n<!-- docs/examples/together.py -->\n```python\n{texts_of('together.py')}```\n\nB\n"
    )
    assert not examples.update(page)


def texts_of(name: str) -> str:
    return (examples.FOLDER / name).read_text()


def test_the_readme_shows_the_sample_plugin_as_it_is() -> None:
    source = (ROOT / "plugins/sample/plugin.py").read_text()
    assert source in (ROOT / "README.md").read_text()
    assert len(source.splitlines()) <= 40


def test_the_readme_lists_the_seventeen_calls() -> None:
    text = (ROOT / "README.md").read_text()
    for thesis, ours, section in SEVENTEEN:
        name = ours if ours == "connect" else f"EAL.{ours}"
        assert f"| `{thesis}` | `{name}` | {section} |" in text


def test_every_link_between_pages_leads_somewhere() -> None:
    for page in (*PAGES, *TUTORIALS):
        for target in re.findall(r"\]\((?!https?://)([^)#]+)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.relative_to(ROOT)} links to {target}"


@pytest.mark.parametrize("module", ["eal_actors", "eal_actors.plugin", "eal_actors.scenario", "eal_actors.testing"])
def test_the_reference_has_every_public_name(module: str) -> None:
    reference = "".join(page.read_text() for page in (ROOT / "docs/reference").glob("*.md"))
    names = set(re.findall(r"auto\w+:: (?:[\w.]+\.)?(\w+)", reference)) | set(re.findall(r"`(\w+)`", reference))
    public = importlib.import_module(module).__all__
    assert [name for name in public if name not in names and not hasattr(errors, name)] == []


def test_the_page_of_worlds_lists_those_that_come_with_the_framework() -> None:
    rows = re.findall(r"^\| `(\w+)` \| (\S+) x (\S+) m \|", (ROOT / "docs/worlds.md").read_text(), re.MULTILINE)
    worlds = {name: load_world(name).size_m for name in bundled_names("world")}
    assert {name: (float(x_m), float(y_m)) for name, x_m, y_m in rows} == worlds


def test_the_robots_of_the_readme_answer_while_they_turn(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Fleet, "load", lambda name: patient_fleet(ROOT / f"fleets/{name}.yaml", rate="max"))
    (code,) = (
        text for kind, text in BLOCK.findall((ROOT / "README.md").read_text()) if kind == "python" and "turns =" in text
    )
    exec(code, {})  # noqa: S102
    statuses = re.search(r"answered while they turn: (.*)", code)
    assert statuses is not None
    assert capsys.readouterr().out.splitlines()[0] == f"[{statuses[1]}]"


def errors_of(kind: type[errors.EALError]) -> list[type[errors.EALError]]:
    """Return an error of the framework with all below it."""
    return [
        kind,
        *(each for below in kind.__subclasses__() if below.__module__ == errors.__name__ for each in errors_of(below)),
    ]


@pytest.mark.parametrize("kind", errors_of(errors.EALError), ids=lambda kind: str(kind.code))
def test_each_error_code_has_a_paragraph_that_the_command_line_links_to(
    kind: type[errors.EALError], capsys: pytest.CaptureFixture[str]
) -> None:
    error = errors.ConfigError(()) if kind is errors.ConfigError else kind("no")
    code = report_error(error, GlobalOptions())
    link = capsys.readouterr().err.splitlines()[-1]
    page, anchor = link.removeprefix(f"{kind.code}: https://github.com/eal-actors/eal-actors/blob/main/").split("#")
    paragraphs = re.findall(
        rf"^### {anchor}\n\n`(\w+)`(?:, an? `(\w+)`)?\. Exit code (\d)\. ", (ROOT / page).read_text(), re.MULTILINE
    )
    builtin = next((base.__name__ for base in kind.__mro__ if not issubclass(base, errors.EALError)), "")
    assert paragraphs == [
        (kind.__name__, "" if builtin == "Exception" and kind is not errors.EALError else builtin, str(int(code)))
    ]


def test_the_page_of_error_codes_has_no_others() -> None:
    codes = re.findall(r"^### (\w+)$", (ROOT / "docs/troubleshooting.md").read_text(), re.MULTILINE)
    assert sorted(codes) == sorted([*(kind.code for kind in errors_of(errors.EALError)), "usage"])
