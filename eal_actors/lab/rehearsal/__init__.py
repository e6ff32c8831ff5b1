"""Rehearsals: run a scenario in simulation, and report where robots come too close to anything.

twins = simulated(EALConfigManager.load("fleets/sim.yaml").fleet, ["roomba-1"])
rehearsal = rehearse(load_scenario("scenarios/dance.yaml"), twins, margin_m=0.1, seed=1)
"""
