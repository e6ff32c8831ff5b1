from __future__ import annotations

from pathlib import Path

import pytest

from evbotos.apt_sources import Source, sources_for
from evbotos.errors import BuildError

DEB822 = """Types: deb
# a comment
URIs: http://one.example/debian/
Suites: bookworm bookworm-updates
Components: main contrib
Signed-By: /usr/share/keyrings/a.gpg

Types: deb
URIs: http://one.example/debian-security
Suites: bookworm-security
Components: main
Signed-By: /usr/share/keyrings/a.gpg

Types: deb-src
URIs: http://one.example/debian
Suites: bookworm
Components: main
"""
ONE_LINE = """# deb http://old.example/debian bookworm main
deb [arch=amd64 signed-by=/k.gpg] http://two.example/debian bookworm main
deb http://tools.example/apt tools-bookworm main
"""


def folder(tmp_path: Path, **files: str) -> Path:
    (tmp_path / "sources.list.d").mkdir(exist_ok=True)
    for name, content in files.items():
        (tmp_path / "sources.list.d" / name.replace("_", ".")).write_text(content)
    return tmp_path


def test_both_forms_of_apts_configuration_are_read(tmp_path: Path) -> None:
    found = sources_for("bookworm", None, folder(tmp_path, a_sources=DEB822, b_list=ONE_LINE))
    assert found == [
        Source("http://one.example/debian", "bookworm", ("main", "contrib"), "/usr/share/keyrings/a.gpg"),
        Source("http://one.example/debian", "bookworm-updates", ("main", "contrib"), "/usr/share/keyrings/a.gpg"),
        Source("http://one.example/debian-security", "bookworm-security", ("main",), "/usr/share/keyrings/a.gpg"),
        Source("http://two.example/debian", "bookworm", ("main",), "/k.gpg"),
    ]
    assert [source.archive for source in found] == ["main", "updates", "security", "main"]


def test_what_others_offer_is_not_debians(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="no source of Debian; name one as `mirror`"):
        sources_for("bookworm", None, folder(tmp_path, a_list="deb http://tools.example/apt tools-bookworm main\n"))


def test_a_newer_suite_comes_from_the_same_archives(tmp_path: Path) -> None:
    found = sources_for("trixie", None, folder(tmp_path, a_sources=DEB822), has_backports=True)
    assert [(source.uri, source.suite) for source in found] == [
        ("http://one.example/debian", "trixie"),
        ("http://one.example/debian", "trixie-updates"),
        ("http://one.example/debian-security", "trixie-security"),
        ("http://one.example/debian", "trixie-backports"),
    ]
    assert {source.signed_by for source in found} == {"/usr/share/keyrings/a.gpg"}


def test_the_users_mirror_is_the_only_source(tmp_path: Path) -> None:
    (source,) = sources_for("bookworm", "http://mine.example/debian/", folder(tmp_path, a_sources=DEB822))
    assert source.line().endswith("http://mine.example/debian bookworm main")


def test_the_users_mirror_has_the_backports_too(tmp_path: Path) -> None:
    found = sources_for("trixie", "http://mine.example/debian", folder(tmp_path), has_backports=True)
    assert [(source.uri, source.suite, source.archive) for source in found] == [
        ("http://mine.example/debian", "trixie", "main"),
        ("http://mine.example/debian", "trixie-backports", "main"),
    ]
