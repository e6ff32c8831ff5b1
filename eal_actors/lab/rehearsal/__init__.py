"""Rehearsals: a scenario in simulation before it is run for good, and who comes too near to what.

config = simulated(EALConfigManager.load("fleets/sim.yaml").fleet).config
rehearsal = rehearse(load_scenario("scenarios/dance.yaml"), config, margin_m=0.1)
"""

from eal_actors.lab.rehearsal.approaches import Approach, Approaches, Nearest
from eal_actors.lab.rehearsal.rehearse import Incident, Rehearsal, rehearse

__all__ = [
    "Approach",
    "Approaches",
    "Incident",
    "Nearest",
    "Rehearsal",
    "rehearse",
]
