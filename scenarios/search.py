"""Robots sweep a floor for a beacon; the first that hears it stops the others: search.yaml in Python."""

import argparse
import math

from eal_actors import Fleet, RobotHandle, as_completed
from eal_actors.lab.choreography.aiming import commands_to


def search(fleet: Fleet, beacon: int = 0) -> tuple[str, float, float] | None:
    """Return the robot that heard a beacon first, and where the beacon is in m; None if no robot heard it."""
    length_m, width_m, lane_m = 9.0, 7.2, 1.2
    lanes = max(1, math.ceil(width_m / len(fleet) / lane_m))  # of each robot's strip

    def seek(robot: RobotHandle, index: int) -> tuple[str, float, float] | None:
        for turn in range(2 * lanes):  # to the start of a lane, then along it; one lane east, the next one west
            goal_x_m = ((turn + 1) // 2 % 2 - 0.5) * (length_m - lane_m)
            goal_y_m = width_m * ((index + (turn // 2 + 0.5) / lanes) / len(fleet) - 0.5)
            for command in commands_to(robot, (goal_x_m, goal_y_m), near_m=0.1):
                drive = robot["Base"].send_cmd(command)
                while not drive.done():
                    bearing_rad, range_m = map(float, robot["Beacons"].get_value().get().value[beacon])
                    if not math.isnan(range_m):
                        x_m, y_m, yaw_rad = map(float, robot["TruePose"].get_value().get().value)
                        angle_rad = yaw_rad + bearing_rad
                        return robot.name, x_m + range_m * math.cos(angle_rad), y_m + range_m * math.sin(angle_rad)
                    fleet.clock.sleep(0.1)
                drive.get()
        return None

    with fleet.tasks() as tasks:
        seekers = [tasks.start(seek, robot, index) for index, robot in enumerate(fleet.values())]
        found = next((heard for seeker in as_completed(seekers) if (heard := seeker.get())), None)
        tasks.cancel()  # halts every robot
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/search.yaml")
    parser.add_argument("--beacon", type=int, default=0, help="its number, in the order of the world file")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as seeking:
        print("first heard by, x and y in m:", search(seeking, arguments.beacon))
