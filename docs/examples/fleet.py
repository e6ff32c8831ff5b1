from eal_actors import Fleet, as_completed, first, gather

with Fleet.load("sim") as fleet:
    roomba = fleet["roomba-1"]  # a fleet maps names to robots, a robot maps names to resources
    wheeled = fleet.select(tags=["wheeled"])  # robots that match all of names, tags=, types=
    print(list(roomba), [robot.name for robot in wheeled])
    print(gather(robot["Pose"].get_value() for robot in wheeled).get())  # all, in this order
    for turn in as_completed([robot["Base"].send_cmd("r45") for robot in wheeled]):
        print(turn, turn.get())  # in the order of completion
    print(first([robot["Base"].send_cmd("f0.3") for robot in wheeled]).get())  # the first success; cancels the others
