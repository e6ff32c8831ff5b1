"""Guards drive from place to place, lap after lap, and report what has come or gone: patrol.yaml in Python."""

import argparse
import math
from typing import Any

from eal_actors import Fleet, RobotHandle
from eal_actors.lab.choreography.aiming import drive_to, turn_command
from eal_actors.lab.choreography.changes import find_changes

PLACES = ((-1.2, 1.8, 205), (-1.2, -1.8, 155), (1.2, 1.8, -25), (1.2, -1.8, 25))  # x, y in m; heading in degrees


def patrol(fleet: Fleet, laps: int = 3, rest_s: float = 5.0) -> list[tuple[str, int, int]]:
    """Send every guard round its share of the places; return the guard, lap and place of each change."""
    guards = fleet.select(tags=["guard"])

    def go_round(guard: RobotHandle) -> list[tuple[str, int, int]]:
        index, changes = guards.index(guard), []
        before: dict[int, Any] = {}
        for lap in range(laps):
            for place in range(index * len(PLACES) // len(guards), (index + 1) * len(PLACES) // len(guards)):
                x_m, y_m, heading_deg = PLACES[place]
                drive_to(guard, (x_m, y_m), near_m=0.02, most_legs=100)
                for _ in range(2):  # the second turn corrects the error of the first
                    yaw_rad = guard["TruePose"].get_value().get().value[2]
                    guard["Base"].send_cmd(turn_command(yaw_rad, math.radians(heading_deg))).get()
                picture = guard["Camera"].get_value(timeout_s=3600).get().value  # the fleet's clock may run fast
                if place in before and find_changes(before[place], picture).boxes:
                    changes.append((guard.name, lap, place))
                before[place] = picture
            fleet.clock.sleep(rest_s)
        return changes

    return [change for changes in fleet.each(guards, go_round).values() for change in changes]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/patrol.yaml")
    parser.add_argument("--laps", type=int, default=3)
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as patrolled:
        found = patrol(patrolled, arguments.laps)
    print(f"{len(found)} changes in {arguments.laps} laps, each as guard, lap, place:", *found)
