"""Conformance: what every plugin must do, checked in a real fleet.

`eal plugin check` runs the checks for an author, `tests/conformance` for the plugins that are shipped. A check uses
what every user of the framework uses, fleets and handles, and knows nothing of any plugin in particular.
"""

from eal_actors.conformance.bench import Bench, Findings, settings_of
from eal_actors.conformance.runner import CHECKS, Check, CheckResult, run_check, run_checks

__all__ = ["CHECKS", "Bench", "Check", "CheckResult", "Findings", "run_check", "run_checks", "settings_of"]
