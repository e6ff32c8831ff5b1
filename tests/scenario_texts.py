"""Texts of scenarios for tests."""

from __future__ import annotations

BOMB = """\
steps:
- let: {n: 200}
- let: {a: "range(8000 + n)"}
- let: {b: [a, a, a, a, a, a, a, a, a, a]}
- let: {c: [b, b, b, b, b, b, b, b, b, b]}
- log: '${len(c)}'
"""
"""Steps whose values grow out of others until one has too many items: `steps[3]`, at line 5."""


def scenario_of(*steps: str, name: str = "trial", role: str = "all", description: str = "A trial.") -> str:
    """Return a scenario with one role, whose robots do these steps; the first step is in line 8."""
    head = f"version: 1\nname: {name}\ndescription: {description}\nroles: {{{role}: {{}}}}\n"
    return f"{head}steps:\n  - on: {role}\n    do:\n" + "".join(f"      - {step}\n" for step in steps)
