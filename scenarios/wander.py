"""Two controllers share one robot: one wanders and keeps off the walls, one stops it when it bumps into something.

Each runs in its own thread and knows nothing of the other: the robot's actors keep them apart.
"""

import argparse
import threading

from eal_actors import EALError, Fleet, RobotHandle
from eal_actors.kernel.clock import Clock

CLEARANCE_M = 0.5
LOOK_S = 0.05  # from one look at a sensor to the next, on the fleet's clock
AHEAD = (-2, -1, 0, 1, 2)  # the rays that look forward, counted counter-clockwise from straight ahead


def avoid_walls(robot: RobotHandle, stop: threading.Event, clock: Clock) -> int:
    """Drive until something is near, turn away, drive on; return how often it turned."""
    base, ranges, turns = robot["Base"], robot["Range"], 0
    while not stop.is_set():
        drive = base.send_cmd("f5")
        while not drive.done() and not stop.is_set():
            seen = ranges.get_value().get().value
            if min(seen[ray] for ray in AHEAD) < CLEARANCE_M:
                left, right = sum(seen[1:8]), sum(seen[9:16])
                turns += 1
                base.send_cmd("l100" if left > right else "r100").get()  # takes over from the drive
                break
            clock.sleep(LOOK_S)
    return turns


def watch_bumper(robot: RobotHandle, stop: threading.Event, clock: Clock, until_s: float) -> str:
    """Halt the robot and end the walk when it touches something, or when the time is over; return why."""
    reason = "the time is over"
    while clock.now() < until_s:
        if robot["Bump"].get_value().get().value:
            reason = "it touched something"
            break
        clock.sleep(LOOK_S)
    stop.set()
    robot.halt().get()
    return reason


def wander(fleet: Fleet, robot: RobotHandle, duration_s: float) -> tuple[int, str]:
    """Run both controllers for a time of the fleet's clock; return the number of turns and why it ended."""
    stop = threading.Event()
    turns: list[int] = []

    def control() -> None:
        try:
            turns.append(avoid_walls(robot, stop, fleet.clock))
        except EALError:
            if not stop.is_set():  # once the watcher has halted the robot, its turn may be cut short
                raise
            turns.append(-1)

    avoider = threading.Thread(target=control, name="avoid walls")
    fleet.clock.start(avoider)
    try:
        reason = watch_bumper(robot, stop, fleet.clock, fleet.clock.now() + duration_s)
    finally:
        stop.set()
        with fleet.clock.outside():  # joining is no wait for the clock
            avoider.join()
    return turns[0], reason


def main() -> None:
    """Read the command line and wander."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/sim.yaml")
    parser.add_argument("--robot", default="roomba-1")
    parser.add_argument("--seconds", type=float, default=30.0, help="of the fleet's clock")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        turns, reason = wander(fleet, fleet[arguments.robot], arguments.seconds)
    print(f"{arguments.robot} turned away {turns} times and stopped because {reason}")


if __name__ == "__main__":
    main()
