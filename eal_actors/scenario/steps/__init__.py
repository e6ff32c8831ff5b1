"""The step kinds of the scenario language.

A kind holds its model, its expressions, its checks, its wording and its execution. `registry` finds the kinds in the
modules of this package, `base` defines the interface, and nothing outside of this package asks a step for its kind. To
add a kind, add it to a module here, or in a new one, with its test, and its entry in docs/scenarios.md.
"""
