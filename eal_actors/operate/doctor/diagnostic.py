"""A finding: one thing that was looked at, and what to do about it."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Severity(enum.StrEnum):
    """How a finding is to be taken."""

    OK = "ok"
    WARNING = "warning"
    """It works now, or may work; it is worth a look."""
    PROBLEM = "problem"
    """Something will not work."""


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """What came of one check.

    Attributes:
        level: how it is to be taken.
        area: what it belongs to, such as `clock` or `devices`.
        what: what was found.
        advice: what to do about it; empty where nothing is to be done.
    """

    level: Severity
    area: str
    what: str
    advice: str = ""


def ok(area: str, what: str) -> Diagnostic:
    """Return that something is as it should be."""
    return Diagnostic(Severity.OK, area, what)


def warning(area: str, what: str, advice: str) -> Diagnostic:
    """Return that something is worth a look."""
    return Diagnostic(Severity.WARNING, area, what, advice)


def problem(area: str, what: str, advice: str) -> Diagnostic:
    """Return that something will not work."""
    return Diagnostic(Severity.PROBLEM, area, what, advice)
