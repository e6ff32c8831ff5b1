"""Parameter sweeps: runs of a scenario over ranges of its parameters and seeds, in several processes, in one table.

sweep = Sweep(scenario, fleet, (), read_variations(scenario, ["side=0.5:1.5:0.5"], 1000), seeds=(1, 2, 3))
"""
