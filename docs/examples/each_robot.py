from eal_actors import EALError, Fleet, RobotHandle


def drive_square(robot: RobotHandle) -> float:
    for _ in range(4):
        robot["Base"].send_cmd("f0.3").get()  # blocks this robot's function only
        robot["Base"].send_cmd("r90").get()
    return robot.clock.now()


with Fleet.load("sim") as fleet:
    for name, end_s in fleet.each(fleet.select(tags=["wheeled"]), drive_square, timeout_s=120).items():
        print(f"{name} was done after {end_s:.1f} s")

    def fail_or_drive(robot: RobotHandle) -> None:
        if robot.name == "roomba-1":
            raise ValueError("no square today")
        drive_square(robot)

    try:
        fleet.each(fleet, fail_or_drive)
    except (ValueError, EALError) as error:
        print(error, [robot["Base"].get_status().get() for robot in fleet.values()])  # all stand
