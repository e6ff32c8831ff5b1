"""Robots that stand anywhere form a shape, phase by phase, and nobody comes near anybody: formation.yaml in Python."""

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

from eal_actors import Fleet, RobotHandle, gather
from eal_actors.device.world.formation import Formation
from eal_actors.kernel.errors import UnavailableError
from eal_actors.lab.choreography.aiming import leg_commands, turn_command
from eal_actors.lab.choreography.step import clearance_m, plan_shape

NEAR_M = 0.03
MOST_LEGS = 100
LONGEST_M = 0.5  # wheels err, so look where the robots are after so much of the way, and aim again
Pose = tuple[float, float, float]


def poses_of(robots: Sequence[RobotHandle]) -> list[Pose]:
    """Return where robots are, all asked at once."""
    answers = gather([robot["Pose"].get_value() for robot in robots]).get()
    return [(float(x_m), float(y_m), float(yaw_rad)) for x_m, y_m, yaw_rad in (answer.value for answer in answers)]


def form(robots: Sequence[RobotHandle], shape: str, spacing_m: float, radius_m: float = 0.2) -> float:
    """Form a shape round the origin; return how far off its place the worst robot is, in m."""
    starts = {robot.name: pose[:2] for robot, pose in zip(robots, poses_of(robots), strict=True)}
    rule = Formation.model_validate({"shape": shape, "count": len(robots), "spacing_m": spacing_m})
    plan = plan_shape(starts, rule, clearance_m(radius_m, margin_m=0.1))
    places = plan["places"]
    with standing_still_in_the_end(robots):
        for phase in plan["phases"]:
            go_to_places(robots, phase)
        turns = [
            robot["Base"].send_cmd(turn_command(pose[2], math.radians(places[robot.name][2])))
            for robot, pose in zip(robots, poses_of(robots), strict=True)
        ]
        gather(turns).get()
    return max(off_m(pose, places[robot.name]) for robot, pose in zip(robots, poses_of(robots), strict=True))


def go_to_places(robots: Sequence[RobotHandle], places: Mapping[str, Sequence[float]]) -> None:
    """Drive robots to their places, all at once, and wait for the last.

    Raises:
        UnavailableError: a robot does not get there.
    """
    going = list(robots)
    for _ in range(MOST_LEGS):
        far = [(r, p) for r, p in zip(going, poses_of(going), strict=True) if off_m(p, places[r.name]) > NEAR_M]
        if not far:
            return
        legs = [(r, *leg_commands(p, (places[r.name][0], places[r.name][1]), LONGEST_M)) for r, p in far]
        gather([robot["Base"].send_cmd(turn) for robot, turn, _ in legs]).get()
        gather([robot["Base"].send_cmd(way) for robot, _, way in legs]).get()
        going = [robot for robot, _ in far]
    raise UnavailableError(f"does not get to its place in {MOST_LEGS} legs", robot=going[0].name)


def off_m(pose: Sequence[float], place: Sequence[float]) -> float:
    """Return how far a robot is from its place."""
    return math.dist(pose[:2], place[:2])


@contextmanager
def standing_still_in_the_end(robots: Sequence[RobotHandle]) -> Iterator[None]:
    """Halt the robots at the end, whatever happens."""
    try:
        yield
    finally:
        gather([robot.halt() for robot in robots]).get()


def main() -> None:
    """Read the command line and form a shape."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/formation.yaml")
    parser.add_argument("--shape", default="circle", choices=["line", "column", "wedge", "circle", "grid"])
    parser.add_argument("--spacing", type=float, default=1.0, help="from neighbour to neighbour, in m")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        worst_m = form(list(fleet.values()), arguments.shape, arguments.spacing)
    print(f"{len(fleet.config.robots)} robots form a {arguments.shape}; the worst is {worst_m * 1000:.0f} mm off")


if __name__ == "__main__":
    main()
