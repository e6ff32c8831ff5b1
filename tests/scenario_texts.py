"""Texts of scenarios for tests."""

from __future__ import annotations


def scenario_of(*steps: str, name: str = "trial", role: str = "all", description: str = "A trial.") -> str:
    """Return a scenario with one role, whose robots do these steps; the first step is in line 8."""
    head = f"version: 1\nname: {name}\ndescription: {description}\nroles: {{{role}: {{}}}}\n"
    return f"{head}steps:\n  - on: {role}\n    do:\n" + "".join(f"      - {step}\n" for step in steps)
