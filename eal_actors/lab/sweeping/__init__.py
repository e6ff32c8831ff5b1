"""Parameter sweeps: runs of a scenario over ranges of its parameters and seeds, in several processes, in one table.

sweep = Sweep(scenario, fleet, (), read_variations(scenario, ["side=0.5:1.5:0.5"], 1000), seeds=(1, 2, 3))
"""

from eal_actors.lab.sweeping.folder import SweepFolder
from eal_actors.lab.sweeping.results import SweepResult, write_csv, write_junit
from eal_actors.lab.sweeping.sweep import Sweep, SweepJob
from eal_actors.lab.sweeping.variations import Variation, read_seeds, read_variations

__all__ = [
    "Sweep",
    "SweepFolder",
    "SweepJob",
    "SweepResult",
    "Variation",
    "read_seeds",
    "read_variations",
    "write_csv",
    "write_junit",
]
