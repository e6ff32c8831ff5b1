"""Every robot with a camera turns in place and takes a picture every 45 degrees (thesis §6.2.2); they are stitched."""

import argparse
import math
from dataclasses import dataclass, field
from pathlib import Path

from eal_actors import EALData, Fleet, Future, RobotHandle, gather
from eal_actors.kernel.errors import ArgumentError
from eal_actors.lab.panorama import stitch
from eal_actors.lab.panorama.folder import save_panorama

PICTURES = 8


@dataclass
class Shots:
    """The frames of a robot, and its heading by odometry at each."""

    frames: list[EALData] = field(default_factory=list)
    yaws_rad: list[float] = field(default_factory=list)


def take_panorama(robots: list[RobotHandle]) -> dict[str, Shots]:
    """Return each robot's frames, one every 45 degrees to the right."""
    taken: dict[str, Shots] = {robot.name: Shots() for robot in robots}
    for _ in range(PICTURES):
        gather([robot["Base"].send_cmd("r45") for robot in robots]).get()
        poses: list[Future[EALData]] = [robot["Odometry"].get_value() for robot in robots]
        frames: list[Future[EALData]] = [robot["Camera"].get_value() for robot in robots]
        for shots, pose, frame in zip(taken.values(), gather(poses).get(), gather(frames).get(), strict=True):
            shots.yaws_rad.append(float(pose.value[2]))
            shots.frames.append(frame)
    return taken


def main() -> None:
    """Read the command line, take the pictures, stitch and save them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="panorama")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="the folder for the pictures")
    parser.add_argument("--field-of-view", type=float, default=60.0, help="of the cameras, in degrees")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        taken = take_panorama([robot for robot in fleet.values() if "Camera" in robot])
    for name, shots in taken.items():
        try:
            frames = [frame.value for frame in shots.frames]
            panorama = stitch(frames, shots.yaws_rad, math.radians(arguments.field_of_view))
        except ArgumentError as error:
            print(f"{name}: {error}")
            continue
        file = arguments.out / f"panorama-{name}.png"
        save_panorama(panorama, file)
        print(f"{name}: {len(panorama.placed)} of {len(frames)} pictures in {file}")
        for number, reason in panorama.unplaced.items():
            print(f"  frame {number} {reason}")


if __name__ == "__main__":
    main()
