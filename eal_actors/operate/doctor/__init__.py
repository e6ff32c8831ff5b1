"""`eal doctor`: looks at a machine and a fleet, and says what to do about what it finds."""

from eal_actors.operate.doctor.examination import examine_fleet, examine_machine
from eal_actors.operate.doctor.finding import Finding, Level

__all__ = ["Finding", "Level", "examine_fleet", "examine_machine"]
