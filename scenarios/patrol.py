"""Guards go round from place to place, lap after lap, and see what has come or gone: patrol.yaml in Python.

Each guard is led by a thread of its own, whose outcome is a future; `gather` waits for all of them.
"""

import argparse
import math
import threading
from collections.abc import Sequence
from typing import NamedTuple

from eal_actors import EALData, EALError, Fleet, Future, RobotHandle, gather
from eal_actors.kernel.clock import Clock
from eal_actors.kernel.errors import UnavailableError
from eal_actors.lab.choreography.aiming import leg_commands, turn_command
from eal_actors.lab.choreography.changes import find_changes

PLACES = (
    (-1.2, 1.8, 205),
    (-1.2, -1.8, 155),
    (1.2, 1.8, -25),
    (1.2, -1.8, 25),
)  # x and y in m, where to look in degrees
LAPS, REST_S = 3, 5.0
NEAR_M, LONGEST_M, MOST_LEGS = 0.02, 1.0, 100
PICTURE_S = 3600.0  # of the fleet's clock, which may run fast


class Sight(NamedTuple):
    """Something that came or went: who saw it, in which lap, at the place of which number."""

    robot: str
    lap: int
    place: int


def look_from(guard: RobotHandle, place: Sequence[float]) -> EALData:
    """Go to a place, look the way that belongs to it, and return the picture.

    Raises:
        UnavailableError: the robot does not get there.
    """
    x_m, y_m, look_deg = place
    for _ in range(MOST_LEGS):
        pose = guard["Pose"].get_value().get().value
        if math.dist(pose[:2], (x_m, y_m)) <= NEAR_M:
            break
        for command in leg_commands(pose, (x_m, y_m), LONGEST_M):
            guard["Base"].send_cmd(command).get()
    else:
        raise UnavailableError(f"does not get to ({x_m}, {y_m}) in {MOST_LEGS} legs", robot=guard.name)
    for _ in range(2):  # the second time makes up for what the first turn erred
        yaw_rad = guard["Pose"].get_value().get().value[2]
        guard["Base"].send_cmd(turn_command(yaw_rad, math.radians(look_deg))).get()
    return guard["Camera"].get_value(timeout_s=PICTURE_S).get()


def go_round(guard: RobotHandle, places: Sequence[int], laps: int, sights: Future[list[Sight]], clock: Clock) -> None:
    """Go round, and hold each picture against that of the lap before; keep in the future what came of it."""
    seen: list[Sight] = []
    before: dict[int, EALData] = {}
    try:
        for lap in range(laps):
            for place in places:
                picture = look_from(guard, PLACES[place])
                if place in before and find_changes(before[place].value, picture.value).boxes:
                    seen.append(Sight(guard.name, lap, place))
                before[place] = picture
            clock.sleep(REST_S)
        sights.set(seen)
    except EALError as error:
        sights.set_exception(error)
    finally:
        guard.halt().exception()


def patrol(fleet: Fleet, laps: int = LAPS) -> list[Sight]:
    """Go round with every guard of a fleet, each at its share of the places; return what they saw come or go.

    Raises:
        EALError: a guard failed; the others went on to the end of their rounds.
    """
    guards = fleet.select(tags=["guard"])
    outcomes: list[Future[list[Sight]]] = [Future(clock=fleet.clock) for _ in guards]
    leaders = []
    for index, (guard, sights) in enumerate(zip(guards, outcomes, strict=True)):
        share = range(index * len(PLACES) // len(guards), (index + 1) * len(PLACES) // len(guards))
        leaders.append(threading.Thread(target=go_round, args=(guard, share, laps, sights, fleet.clock)))
    for leader in leaders:
        fleet.clock.start(leader)
    try:
        return [sight for sights in gather(outcomes).get() for sight in sights]
    finally:
        with fleet.clock.outside():  # joining is no wait for the clock
            for leader in leaders:
                leader.join()


def main() -> None:
    """Read the command line, go round, and say what was seen."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/patrol.yaml")
    parser.add_argument("--laps", type=int, default=LAPS)
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        sights = patrol(fleet, arguments.laps)
    for robot, lap, place in sights:
        print(f"{robot}: place {place} has changed in lap {lap}")
    print(f"{len(sights)} changes in {arguments.laps} laps")


if __name__ == "__main__":
    main()
