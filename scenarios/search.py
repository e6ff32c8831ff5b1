"""Robots sweep a floor for a beacon; the first that hears it stops the others: search.yaml in Python."""

import argparse
import math

from eal_actors import Fleet, RobotHandle, as_completed

LANES = range(1, 9)
SWEEP = [f"{end}-{lane}" for lane in LANES for end in (("west", "east") if lane % 2 else ("east", "west"))]


def search(fleet: Fleet, beacon: int = 0) -> tuple[str, float] | None:
    """Return the robot that heard a beacon first, and its distance in m; None if no robot heard it."""
    seekers = [robot for robot in fleet.values() if "Beacons" in robot]
    share = len(SWEEP) // len(seekers)

    def seek(robot: RobotHandle, index: int) -> tuple[str, float] | None:
        for place in SWEEP[index * share : (index + 1) * share]:
            trip = fleet.go_to({robot: place})
            while not trip.done():
                range_m = float(robot["Beacons"].get_value().get().value[beacon][1])
                if not math.isnan(range_m):
                    return robot.name, range_m
                fleet.clock.sleep(0.1)
            trip.get()
        return None

    with fleet.tasks() as tasks:
        running = [tasks.start(seek, robot, index) for index, robot in enumerate(seekers)]
        found = next((heard for seeker in as_completed(running) if (heard := seeker.get())), None)
        tasks.cancel()  # halts every robot
    return found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="search")
    parser.add_argument("--beacon", type=int, default=0, help="its number, in the order of the world file")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as seeking:
        print("first heard by, and how far away in m:", search(seeking, arguments.beacon))
