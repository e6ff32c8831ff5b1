from eal_actors.kernel.errors import DeadlineError
from eal_actors.testing import Simulation

with Simulation({"scout": "roomba"}) as simulation:
    simulation.inject("scout", motor_left=0.5, link_delay_s=0.2)
    simulation["scout"]["Base"].send_cmd("f0.5").get()
    print(simulation.pose("scout"))  # it has turned left

    simulation.inject("scout", dead=True)
    try:
        simulation["scout"]["Bump"].get_value(timeout_s=2).get()
    except DeadlineError as error:
        print(error)
    simulation.clear_faults("scout")
    print(simulation["scout"]["Bump"].get_value().get())
