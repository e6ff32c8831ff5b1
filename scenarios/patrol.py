"""Guards visit places lap after lap, and report what has come or gone: patrol.yaml in Python."""

import argparse
from typing import Any

from eal_actors import Fleet, RobotHandle
from eal_actors.lab.changes.detection import find_changes

PLACES = ("northwest", "southwest", "northeast", "southeast")


def patrol(fleet: Fleet, laps: int = 3, rest_s: float = 5.0) -> list[tuple[str, int, str]]:
    """Send every guard round its share of the places; return the guard, lap and place of each change."""
    guards = fleet.select(tags=["guard"])

    def go_round(guard: RobotHandle) -> list[tuple[str, int, str]]:
        share = len(PLACES) // len(guards)
        first, changes = guards.index(guard) * share, []
        before: dict[Any, Any] = {}
        for lap in range(laps):
            for place in fleet.visit(guard, PLACES[first : first + share]):
                picture = guard.camera.frame(timeout_s=3600).get()  # the fleet's clock may run fast
                if place in before and find_changes(before[place], picture).boxes:
                    changes.append((guard.name, lap, str(place)))
                before[place] = picture
            fleet.clock.sleep(rest_s)
        return changes

    return [change for changes in fleet.each(guards, go_round).values() for change in changes]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="patrol")
    parser.add_argument("--laps", type=int, default=3)
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as patrolled:
        found = patrol(patrolled, arguments.laps)
    print(f"{len(found)} changes in {arguments.laps} laps, each as guard, lap, place:", *found)
