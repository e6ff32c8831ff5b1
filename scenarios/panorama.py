"""Every robot with a camera turns in place and takes a picture each 45 degrees (thesis §6.2.2), all at once."""

import argparse
from pathlib import Path

import numpy as np

from eal_actors import EALData, Fleet, Future, RobotHandle, gather

PICTURES = 8


def take_panorama(robots: list[RobotHandle]) -> dict[str, list[EALData]]:
    """Return each robot's frames, one every 45 degrees to the right."""
    frames: dict[str, list[EALData]] = {robot.name: [] for robot in robots}
    for _ in range(PICTURES):
        gather([robot["Base"].send_cmd("r45") for robot in robots]).get()
        shots: list[Future[EALData]] = [robot["Camera"].get_value() for robot in robots]
        for robot, frame in zip(robots, gather(shots).get(), strict=True):
            frames[robot.name].append(frame)
    return frames


def main() -> None:
    """Read the command line, take the pictures, save them side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="fleets/sim.yaml")
    parser.add_argument("--out", type=Path, default=Path("runs"), help="the folder for the pictures")
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        frames = take_panorama([robot for robot in fleet.values() if "Camera" in robot])
    arguments.out.mkdir(parents=True, exist_ok=True)
    for name, taken in frames.items():
        file = arguments.out / f"panorama-{name}.npy"
        np.save(file, np.concatenate([frame.value for frame in taken], axis=1))
        print(f"{name}: {len(taken)} pictures, side by side in {file}")


if __name__ == "__main__":
    main()
