"""`eal doctor`: looks at a machine and a fleet, and says what to do about what it finds."""

from eal_actors.operate.doctor.diagnosis import diagnose_fleet, diagnose_machine
from eal_actors.operate.doctor.diagnostic import Diagnostic, Severity

__all__ = ["Diagnostic", "Severity", "diagnose_fleet", "diagnose_machine"]
