"""Two controllers share one robot: one drives and keeps off the walls, one stops it when it touches something.

Each is a task that knows nothing of the other: the robot's actors keep their commands apart.
"""

import argparse

from eal_actors import Fleet, RobotHandle
from eal_actors.kernel.clock import Clock

CLEARANCE_M = 0.5
LOOK_S = 0.05  # between two looks at a sensor, on the fleet's clock
AHEAD = (-2, -1, 0, 1, 2)  # the rays that look forward, counted counter-clockwise from straight ahead


def avoid_walls(robot: RobotHandle, clock: Clock, turns: list[float]) -> None:
    """Drive until something is near, turn away, drive on; add the time of each turn to `turns`."""
    base, ranges = robot["Base"], robot["Range"]
    while True:
        drive = base.send_cmd("f5")
        while not drive.done():
            seen = ranges.get_value().get().value
            if min(seen[ray] for ray in AHEAD) < CLEARANCE_M:
                left, right = sum(seen[1:8]), sum(seen[9:16])
                turns.append(clock.now())
                base.send_cmd("l100" if left > right else "r100").get()  # preempts the drive
                break
            clock.sleep(LOOK_S)


def watch_bumper(robot: RobotHandle, clock: Clock, until_s: float) -> str:
    """Return why the walk is over: the robot touches something, or the time is over."""
    while clock.now() < until_s:
        if robot["Bump"].get_value().get().value:
            return "it touched something"
        clock.sleep(LOOK_S)
    return "the time is over"


def wander(fleet: Fleet, robot: RobotHandle, duration_s: float) -> tuple[int, str]:
    """Run both controllers for a time of the fleet's clock; return the number of turns and why it ended."""
    turns: list[float] = []
    with fleet.tasks() as tasks:
        tasks.start(avoid_walls, robot, fleet.clock, turns)
        reason = watch_bumper(robot, fleet.clock, fleet.clock.now() + duration_s)
        tasks.cancel()  # halts the robot
    return len(turns), reason


def main() -> None:
    """Read the command line and wander."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="sim")
    parser.add_argument("--robot", default="roomba-1")
    parser.add_argument("--seconds", type=float, default=30.0, help="of the fleet's clock")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        turns, reason = wander(fleet, fleet[arguments.robot], arguments.seconds)
    print(f"{arguments.robot} turned away {turns} times and stopped because {reason}")


if __name__ == "__main__":
    main()
