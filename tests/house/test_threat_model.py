"""Each row of the threat model names its tests, and each of these exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "security.md"
TABLES = ("## What each party can do", "## Protections and their tests")


def rows() -> list[str]:
    """Return the rows of the tables whose last column is their tests."""
    text = PAGE.read_text(encoding="utf-8")
    found = []
    for heading in TABLES:
        section = text.partition(f"{heading}\n")[2].partition("\n## ")[0]
        lines = [line for line in section.splitlines() if line.startswith("|")]
        assert lines[0].endswith("| tests |"), heading
        found += lines[2:]
    return found


def test_the_tables_are_there() -> None:
    assert len(rows()) > 25


@pytest.mark.parametrize("row", rows(), ids=lambda row: row.split("|")[1].strip()[:40])
def test_a_row_names_tests_that_exist(row: str) -> None:
    named = re.findall(r"`([^`]+)`", row.rsplit("|", 2)[1])
    assert named
    for name in named:
        file, _, function = name.partition("::")
        path = ROOT / file
        assert path.is_file(), name
        defined = {node.name for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.FunctionDef)}
        wanted = {function} if function else {test for test in defined if test.startswith("test_")}
        assert wanted, name
        assert wanted <= defined, name
