"""Robots that stand anywhere form a shape, phase by phase, without collisions: formation.yaml in Python."""

import argparse
import math
from functools import partial

from eal_actors import Fleet, RobotHandle
from eal_actors.device.world.model import Formation
from eal_actors.lab.choreography.aiming import drive_to, turn_command
from eal_actors.lab.choreography.step import clearance_m, plan_shape


def form(fleet: Fleet, shape: str, spacing_m: float, radius_m: float = 0.2) -> float:
    """Form a shape round the origin; return the largest distance of a robot from its place, in m."""

    def go(robot: RobotHandle, places: dict[str, list[float]]) -> None:
        x_m, y_m = places[robot.name][:2]
        drive_to(robot, (x_m, y_m), near_m=0.03, longest_m=0.5, most_legs=100)

    def face(robot: RobotHandle) -> float:
        x_m, y_m, heading_deg = plan["places"][robot.name]
        yaw_rad = robot["TruePose"].get_value().get().value[2]
        robot["Base"].send_cmd(turn_command(yaw_rad, math.radians(heading_deg))).get()
        return math.dist(robot["TruePose"].get_value().get().value[:2], (x_m, y_m))

    poses = fleet.each(fleet, lambda robot: robot["TruePose"].get_value().get().value)
    starts = {name: (float(pose[0]), float(pose[1])) for name, pose in poses.items()}
    rule = Formation.model_validate({"shape": shape, "count": len(fleet), "spacing_m": spacing_m})
    plan = plan_shape(starts, rule, clearance_m(radius_m, margin_m=0.1))
    for phase in plan["phases"]:  # each phase is over when the last robot has arrived
        fleet.each(fleet, partial(go, places=phase))
    return max(fleet.each(fleet, face).values())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/formation.yaml")
    parser.add_argument("--shape", default="circle", choices=["line", "column", "wedge", "circle", "grid"])
    parser.add_argument("--spacing", type=float, default=1.0, help="from neighbour to neighbour, in m")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as robots:
        worst_m = form(robots, arguments.shape, arguments.spacing)
        print(f"{len(robots)} robots form a {arguments.shape}; the worst is {worst_m * 1000:.0f} mm from its place")
