from eal_actors import Fleet, gather

with Fleet.load("sim") as fleet:
    robots = fleet.select(tags=["indoor"])
    turns = [robot["Base"].send_cmd("r90") for robot in robots]
    fleet.clock.sleep(0.5)
    print([robot["Base"].get_status().get() for robot in robots])  # answered while they turn: 1, 1, 1
    gather(turns).get()
    for robot in robots:
        print(robot.name, robot["Pose"].get_value().get().value.round(2))
