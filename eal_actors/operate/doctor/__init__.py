"""`eal doctor`: checks of a machine and a fleet, with advice."""

from eal_actors.operate.doctor.diagnosis import diagnose_fleet, diagnose_machine
from eal_actors.operate.doctor.diagnostic import Diagnostic, Severity

__all__ = ["Diagnostic", "Severity", "diagnose_fleet", "diagnose_machine"]
