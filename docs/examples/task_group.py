from eal_actors import Fleet, RobotHandle


def watch(robot: RobotHandle, seen: list[float]) -> None:
    while True:
        seen.append(float(robot["Pose"].get_value().get().value[2]))
        robot.clock.sleep(0.2)


with Fleet.load("sim") as fleet:
    headings: list[float] = []
    with fleet.tasks() as tasks:
        tasks.start(watch, fleet["roomba-1"], headings)  # returns a future of the result
        fleet["roomba-1"]["Base"].send_cmd("r180").get()
        tasks.cancel()  # ends the tasks without an error
    print(len(headings), "headings")
