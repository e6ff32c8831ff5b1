"""One robot at a time drives from mark to mark until its battery is low: relay.yaml in Python."""

import argparse

from eal_actors import Fleet, RobotHandle

MARKS = tuple(f"mark-{number}" for number in range(1, 13))
LOW = 0.2


def run_from(fleet: Fleet, robot: RobotHandle, home: str, ahead: list[str]) -> int:
    """Drive from mark to mark until the battery is low, then home; return the number of marks done."""
    done = 0
    while done < len(ahead) and robot["Battery"].get_value().get().value > LOW:
        fleet.go_to({robot: ahead[done]}).get()
        done += 1
    if done:
        fleet.go_to({robot: home}).get()  # off the circuit before the next robot starts
    return done


def relay(fleet: Fleet, laps: int) -> dict[str, int]:
    """Drive round with one robot after the other; return how many marks each did."""
    ahead = list(MARKS) * laps
    runners = [robot for robot in fleet.values() if "Battery" in robot]
    marks: dict[str, int] = {}
    for number, robot in enumerate(runners, start=1):
        marks[robot.name] = run_from(fleet, robot, f"bay-{number}", ahead[sum(marks.values()) :])
    return marks


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="relay")
    parser.add_argument("--laps", type=int, default=2)
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        marks = relay(fleet, arguments.laps)
    print(f"{sum(marks.values())} of {arguments.laps * len(MARKS)} marks: {marks}")
