"""The limits of the structure: entries, layers, sizes, complexity, protocols, and the files that one call enters."""

from __future__ import annotations

import ast
import functools
import re
import subprocess
import sys
import tomllib
from graphlib import TopologicalSorter
from pathlib import Path

import pytest
from radon.complexity import cc_visit_ast  # type: ignore[import-untyped]

from tests.house import prose

ROOT = Path(__file__).parents[2]
CODE = ("eal_actors", "evbotos", "plugins", "scenarios")


def modules(*folders: str) -> list[Path]:
    return [file for folder in folders for file in sorted((ROOT / folder).rglob("*.py"))]


@functools.cache
def tree(file: Path) -> ast.Module:
    return ast.parse(file.read_text())


@functools.cache
def parts(file: Path) -> tuple[list[ast.ClassDef], list[ast.ImportFrom]]:
    """Return the classes and the imports of names in a file."""
    found = [node for node in ast.walk(tree(file)) if isinstance(node, (ast.ClassDef, ast.ImportFrom))]
    return [n for n in found if isinstance(n, ast.ClassDef)], [n for n in found if isinstance(n, ast.ImportFrom)]


def test_the_framework_has_at_most_fourteen_entries() -> None:
    entries = {path.name for path in (ROOT / "eal_actors").iterdir() if not path.name.startswith("__")} - {"py.typed"}
    assert len(entries) <= 14, sorted(entries)


def test_the_design_names_the_layers_of_the_import_contract() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (layers,) = [contract["layers"] for contract in contracts if contract["type"] == "layers"]
    contract = [sorted(layer.split(" | ")) for layer in reversed(layers)]
    rows = re.findall(r"^\| (\d) \| ([^|]+) \|", (ROOT / "DESIGN.md").read_text(), re.MULTILINE)
    design = [sorted(re.findall(r"`([\w]+)(?:/|\.py)?`", modules)) for _, modules in rows]
    assert design == contract
    assert [int(number) for number, _ in rows] == list(range(1, len(layers) + 1))
    assert len(layers) <= 9


def test_no_program_is_started_with_the_modules_of_the_working_folder() -> None:
    """`python -m` puts that folder first: a file `eal_actors.py` there would run in place of the framework."""
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno}"
        for file in modules(*CODE)
        for node in ast.walk(tree(file))
        if isinstance(node, (ast.List, ast.Tuple))
        and re.match(r"(sys\.executable|find_python\(\)), '-m'", ", ".join(map(ast.unparse, node.elts[:2])))
    ]
    assert not found, "\n".join(found)


def test_no_function_is_too_complex() -> None:
    blocks = ((file, block) for file in modules(*CODE) for block in cc_visit_ast(tree(file)))
    found = [
        f"{file.relative_to(ROOT)}:{b.lineno} {b.fullname}: {b.complexity}" for file, b in blocks if b.complexity > 15
    ]
    assert not found, "\n".join(found)


def test_there_are_few_protocols() -> None:
    found = [
        f"{file.relative_to(ROOT)}:{node.lineno} {node.name}"
        for file in modules("eal_actors")
        for node in parts(file)[0]
        if any("Protocol" in ast.unparse(base) for base in node.bases)
    ]
    assert len(found) <= 15, "\n".join(found)


def test_no_file_of_code_is_longer_than_400_lines() -> None:
    command = ["git", "ls-files", "*.py", "*.js", "*.css", "*.j2", "*.html", "*.sh"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, timeout=60).stdout
    lengths = {name: (ROOT / name).read_bytes().count(b"\n") for name in listed.splitlines() if (ROOT / name).is_file()}
    assert len(lengths) > 1000
    assert not {name: length for name, length in lengths.items() if length > 400}


@pytest.mark.parametrize("folder", ["eal_actors", "evbotos", "plugins"])
def test_modules_import_one_way(folder: str) -> None:
    """Imports for types count too."""
    files = {file for file in modules(folder) if file.name != "__init__.py"}
    names = {file.relative_to(ROOT).with_suffix("").parts: file for file in files}
    imports: dict[tuple[str, ...], set[tuple[str, ...]]] = {name: set() for name in names}
    for name, file in names.items():
        for node in parts(file)[1]:
            above = name[: -node.level] if node.level else ()
            module = (*above, *(node.module.split(".") if node.module else ()))
            imports[name] |= {module, *((*module, alias.name) for alias in node.names)} & names.keys()
    assert any(imports.values())
    TopologicalSorter(imports).prepare()  # raises CycleError, with the modules


@pytest.mark.parametrize("folders", [("eal_actors", "plugins"), ("evbotos",)])
def test_a_class_name_means_one_thing(folders: tuple[str, ...]) -> None:
    """Names of the plugin API, of the thesis and of standard resources may recur."""
    may_recur = {"Settings", "EAL", "Base", "Battery", "BridgeSettings", "Bump", "Camera", "Odometry", "Pose", "Turret"}
    found: dict[str, list[str]] = {}
    for file in modules(*folders):
        for node in parts(file)[0]:
            found.setdefault(node.name, []).append(str(file.relative_to(ROOT)))
    twice = {name: files for name, files in found.items() if len(files) > 1 and name not in may_recur}
    assert not twice


def test_the_prose_is_plain_english() -> None:
    assert not list(prose.findings())


@pytest.mark.parametrize(
    "file",
    [".github/workflows/check.yml", ".github/workflows/release.yml", ".github/workflows/slow.yml", "CITATION.cff"],
)
def test_files_for_forges_match_their_schemas(file: str) -> None:
    schema = "vendor.citation-file-format" if file == "CITATION.cff" else "vendor.github-workflows"
    command = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", schema, file]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(("what", "limit"), [("value", 12), ("command", 18), ("scenario", 46)])
def test_one_call_enters_few_files(what: str, limit: int) -> None:
    command = [sys.executable, "-m", "tests.house.entered", what]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60, check=True)
    files = done.stdout.splitlines()
    assert 0 < len(files) <= limit, done.stdout


def test_the_tour_for_contributors_names_files_that_exist() -> None:
    text = (ROOT / "CONTRIBUTING.md").read_text()
    tour = text[text.index("## A two-minute tour") : text.index("## Add something")]
    named = re.findall(r"`(\w+/[\w/]+\.py)`", tour)
    assert len(named) > 15
    assert not [name for name in named if not (ROOT / "eal_actors" / name).is_file()]
