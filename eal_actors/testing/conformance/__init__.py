"""Conformance: what every plugin must do, checked in a real fleet.

`eal plugin check` runs the checks for an author, `tests/testing/conformance` for the bundled plugins. A check uses
fleets and handles, as users do, and knows no plugin by name.
"""

from eal_actors.testing.conformance.bench import Bench, Findings, settings_of
from eal_actors.testing.conformance.runner import CHECKS, Check, CheckResult, run_check, run_checks

__all__ = ["CHECKS", "Bench", "Check", "CheckResult", "Findings", "run_check", "run_checks", "settings_of"]
