"""Conformance checks: the contract of all plugins, checked in a real fleet.

`eal plugin check` runs the checks for plugin authors, `tests/testing/conformance` runs them for the bundled plugins.
The checks use fleets and handles, as users do, and know no plugin by name.
"""

from eal_actors.testing.conformance.bench import Bench, Findings, settings_of
from eal_actors.testing.conformance.runner import CHECKS, Check, CheckResult, run_check, run_checks

__all__ = ["CHECKS", "Bench", "Check", "CheckResult", "Findings", "run_check", "run_checks", "settings_of"]
