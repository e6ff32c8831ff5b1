"""Rehearsals: a scenario in simulation before it is run for good, and who comes too near to what.

config = simulated(EALConfigManager.load("fleets/sim.yaml").fleet).config
rehearsal = rehearse(load_scenario("scenarios/dance.yaml"), config, margin_m=0.1)
"""

from eal_actors.rehearsal.approaches import Approach, Approaches, Nearest
from eal_actors.rehearsal.rehearse import Incident, Rehearsal, rehearse
from eal_actors.rehearsal.step_places import step_place
from eal_actors.rehearsal.twins import Simulated, simulated

__all__ = [
    "Approach",
    "Approaches",
    "Incident",
    "Nearest",
    "Rehearsal",
    "Simulated",
    "rehearse",
    "simulated",
    "step_place",
]
