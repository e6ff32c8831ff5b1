"""A finding: one thing that was looked at, and what to do about it."""

from __future__ import annotations

import enum
from dataclasses import dataclass


class Level(enum.StrEnum):
    """How a finding is to be taken."""

    OK = "ok"
    WARNING = "warning"
    """It works now, or may work; it is worth a look."""
    PROBLEM = "problem"
    """Something will not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """What came of one check.

    Attributes:
        level: how it is to be taken.
        area: what it belongs to, such as `clock` or `devices`.
        what: what was found.
        advice: what to do about it; empty where nothing is to be done.
    """

    level: Level
    area: str
    what: str
    advice: str = ""


def ok(area: str, what: str) -> Finding:
    """Return that something is as it should be."""
    return Finding(Level.OK, area, what)


def warning(area: str, what: str, advice: str) -> Finding:
    """Return that something is worth a look."""
    return Finding(Level.WARNING, area, what, advice)


def problem(area: str, what: str, advice: str) -> Finding:
    """Return that something will not work."""
    return Finding(Level.PROBLEM, area, what, advice)
