from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState

with Fleet.load("sim") as fleet:
    robot = fleet["roomba-1"]
    robot.wait_for_state(RobotState.READY, timeout_s=10).get()
    forget = robot.on_state(lambda state: print("the robot is", state.value))
    drive = robot["Base"].send_cmd("f0.3")
    drive.add_progress_callback(lambda progress: print(progress.fraction, progress.text, progress.time_s))
    fleet.clock.sleep(0.7)
    for running in robot.running:
        print(running.resource, running.command, running.by, running.since_s, running.progress)
    drive.get()
    print(drive.progress())
    forget()
