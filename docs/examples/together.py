# together.py
from eal_actors import Fleet, gather

with Fleet.load("sim") as fleet:
    gather(robot["Base"].send_cmd("r90") for robot in fleet.values()).get()
    for robot in fleet.values():
        print(robot.name, robot["Pose"].get_value().get().value.round(2))
