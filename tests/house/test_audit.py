"""The interpretation of pip-audit's report: an unmentioned package is not audited."""

from __future__ import annotations

from typing import Any

from tests.house.audit import judge, lines

OLD = {
    "name": "jinja2",
    "version": "2.4.1",
    "vulns": [{"id": "PYSEC-2014-8", "fix_versions": ["2.7.2"], "aliases": [], "description": "..."}],
}
GOOD = {"name": "pykka", "version": "4.5.0", "vulns": []}
MISSED = {"name": "numpy", "skip_reason": "Dependency not found on PyPI and could not be audited: numpy (2.4.6)"}
OURS = {"name": "eal-actors", "skip_reason": "distribution marked as editable"}


def report(*dependencies: dict[str, Any]) -> dict[str, Any]:
    return {"dependencies": list(dependencies), "fixes": []}


def test_a_known_vulnerability_is_named_with_what_mends_it() -> None:
    verdict = judge(report(GOOD, OLD, OURS))

    assert verdict.vulnerable == ("jinja2 2.4.1: PYSEC-2014-8; mended in 2.7.2",)
    assert list(lines(verdict))[-1] == "pip-audit: 1 known vulnerabilities in 2 packages"


def test_a_package_that_was_passed_over_is_named() -> None:
    verdict = judge(report(GOOD, MISSED, OURS))

    assert (verdict.vulnerable, verdict.audited) == ((), 1)
    assert f"not audited: numpy: {MISSED['skip_reason']}" in lines(verdict)


def test_where_nothing_could_be_looked_up_that_is_said_loudly() -> None:
    verdict = judge(report(MISSED, OURS))

    assert any(line.startswith("NOT AUDITED") for line in lines(verdict))
