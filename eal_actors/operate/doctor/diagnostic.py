"""Diagnostics: the results of checks, with advice."""

from __future__ import annotations

import enum
from typing import NamedTuple


class Severity(enum.StrEnum):
    """The severity of a diagnostic."""

    OK = "ok"
    WARNING = "warning"
    """It works now, or may work, but needs attention."""
    PROBLEM = "problem"
    """Something will not work."""


class Diagnostic(NamedTuple):
    """The result of one check. Its area is the subject, such as `clock`; its advice is empty if none is needed."""

    level: Severity
    area: str
    what: str
    advice: str = ""


def ok(area: str, what: str) -> Diagnostic:
    """Return a good result."""
    return Diagnostic(Severity.OK, area, what)


def warning(area: str, what: str, advice: str) -> Diagnostic:
    """Return a warning."""
    return Diagnostic(Severity.WARNING, area, what, advice)


def problem(area: str, what: str, advice: str) -> Diagnostic:
    """Return a problem."""
    return Diagnostic(Severity.PROBLEM, area, what, advice)
