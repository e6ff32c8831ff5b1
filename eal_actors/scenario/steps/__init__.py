"""The step kinds of the scenario language, one module each.

A module of a kind holds its model, its expressions, its checks, its wording and its execution. `registry` finds the
modules, `base` defines the interface, and nothing outside of this package asks a step for its kind. To add a kind, add
its module here, its test, and its entry in docs/scenarios.md.
"""
