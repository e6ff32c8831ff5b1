"""Robots sweep a floor for a beacon; `first` of their futures stops the rest: search.yaml in Python.

Each robot is led by a thread of its own, whose outcome is a future. The first that succeeds cancels the others, and a
leader that finds its future cancelled halts its robot.
"""

import argparse
import math
import threading
from collections.abc import Iterator
from typing import NamedTuple

from eal_actors import EALError, Fleet, Future, RobotHandle, first
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import UnavailableError
from eal_actors.lab.choreography.aiming import leg_commands

LENGTH_M, WIDTH_M, LANE_M = 9.0, 7.2, 1.2
NEAR_M, LONGEST_M, MOST_LEGS = 0.1, 1.0, 200
LOOK_S = 0.1  # from one look for the beacon to the next, on the fleet's clock


class Finding(NamedTuple):
    """Who found the beacon, and where it is, in m."""

    robot: str
    x_m: float
    y_m: float


def waypoints(index: int, count: int) -> Iterator[tuple[float, float]]:
    """Yield the ends of the lanes of a robot's strip, one lane east, the next one west."""
    strip_m = WIDTH_M / count
    lanes = max(1, math.ceil(strip_m / LANE_M))
    for lane in range(lanes):
        y_m = -WIDTH_M / 2 + strip_m * (index + (lane + 0.5) / lanes)
        for end in (0, 1):
            yield ((lane + end) % 2 - 0.5) * (LENGTH_M - LANE_M), y_m


def listen(robot: RobotHandle, beacon: int) -> Finding | None:
    """Return where the beacon is, if the robot hears it."""
    bearing_rad, distance_m = map(float, robot["Beacons"].get_value().get().value[beacon])
    if math.isnan(distance_m):
        return None
    x_m, y_m, yaw_rad = map(float, robot["Pose"].get_value().get().value)
    angle_rad = yaw_rad + bearing_rad
    return Finding(robot.name, x_m + distance_m * math.cos(angle_rad), y_m + distance_m * math.sin(angle_rad))


def sweep(robot: RobotHandle, beacon: int, index: int, count: int, found: Future[Finding], clock: Clock) -> None:
    """Go along the lanes until the robot hears the beacon, or somebody else has; keep in the future what came of it."""
    try:
        for goal in waypoints(index, count):
            for _ in range(MOST_LEGS):
                pose = robot["Pose"].get_value().get().value
                if math.dist(pose[:2], goal) <= NEAR_M:
                    break
                for command in leg_commands(pose, goal, LONGEST_M):
                    if not drive_listening(robot, command, beacon, found, clock):
                        return
            else:
                raise UnavailableError(f"does not get to {goal} in {MOST_LEGS} legs", robot=robot.name)
        found.set_exception(UnavailableError("has swept its strip and heard nothing", robot=robot.name))
    except EALError as error:
        found.set_exception(error)
    finally:
        robot.halt().exception()


def drive_listening(robot: RobotHandle, command: str, beacon: int, found: Future[Finding], clock: Clock) -> bool:
    """Drive, and look for the beacon all the while; return whether the search goes on."""
    drive = robot["Base"].send_cmd(command)
    while not drive.done():
        if found.done():  # cancelled, for somebody else was first
            return False
        if (finding := listen(robot, beacon)) is not None:
            found.set(finding)
            return False
        clock.sleep(LOOK_S)
    drive.get()
    return True


def search(fleet: Fleet, beacon: int = 0) -> Finding:
    """Search with every robot of a fleet; return what the first one found.

    Raises:
        EALError: nobody found it; why the last one did not.
    """
    futures: list[Future[Finding]] = [Future(clock=fleet.clock) for _ in fleet]
    leaders = [
        threading.Thread(target=sweep, args=(robot, beacon, index, len(fleet), found, fleet.clock), name=robot.name)
        for index, (robot, found) in enumerate(zip(fleet.values(), futures, strict=True))
    ]
    for leader in leaders:
        fleet.clock.start(leader)
    try:
        return first(futures).get()
    finally:
        for found in futures:
            found.cancel()
        with fleet.clock.outside():  # joining is no wait for the clock
            for leader in leaders:
                leader.join()


def main() -> None:
    """Read the command line and search."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/search.yaml")
    parser.add_argument("--beacon", type=int, default=0, help="its number, in the order of the world file")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        try:
            finding = search(fleet, arguments.beacon)
        except EALError as error:
            print(f"nobody found beacon {arguments.beacon}; {error}")
        else:
            print(f"{finding.robot} found it at x {finding.x_m:.2f} m, y {finding.y_m:.2f} m")


if __name__ == "__main__":
    main()
