from eal_actors.testing import Simulation

with Simulation({"scout": "roomba"}, world="maze", seed=3) as simulation:
    drive = simulation["scout"]["Base"].send_cmd("f0.2")
    simulation.advance(0.5)
    print(simulation.now_s, drive.done(), simulation.pose("scout"))
    drive.get()  # waiting for an answer lets time go on as well
    print(simulation.now_s, drive.done(), simulation.pose("scout"))
