"""A robot turns once round; its IMU tells the yaw, and the scans of its lidar become a picture of the room."""

import argparse
import math
from pathlib import Path
from statistics import fmean

import numpy as np

from eal_actors import Fleet, RobotHandle
from eal_actors.kernel.clock import Clock
from eal_actors.recording.arena import new_figure

AT_REST_S = 2.0  # for the constant error of the turn rate
PERIOD_S = 0.02  # between two readings of the IMU, on the fleet's clock
TURNS = ("l90",) * 4


def turn_rate(robot: RobotHandle) -> tuple[float, float]:
    """Return the time in s and the turn rate about the upright axis in rad/s."""
    reading = robot["Imu"].send_req("turn_rate").get()
    return float(reading.stamp_s or 0.0), float(reading.value[2])


def bias_at_rest(robot: RobotHandle, clock: Clock) -> float:
    """Return the mean turn rate of the standing robot."""
    rates = []
    for _ in range(round(AT_REST_S / PERIOD_S)):
        rates.append(turn_rate(robot)[1])
        clock.sleep(PERIOD_S)
    return fmean(rates)


def turned(robot: RobotHandle, clock: Clock, command: str, bias: float) -> float:
    """Turn in place; return the angle by the IMU, in rad."""
    motion, angle_rad = robot["Base"].send_cmd(command), 0.0
    before_s, _ = turn_rate(robot)
    while not motion.done():
        clock.sleep(PERIOD_S)
        now_s, rate = turn_rate(robot)
        angle_rad += (rate - bias) * (now_s - before_s)
        before_s = now_s
    motion.get()
    return angle_rad


def survey(robot: RobotHandle, clock: Clock) -> tuple[np.ndarray, float]:
    """Scan between the turns.

    Returns:
        What the lidar met, in m from the robot, the first heading along x, of shape (n, 2); and the yaw in the end.
    """
    lidar = robot["Lidar"]
    angles_rad, longest_m = lidar.send_req("angles").get().value, lidar.get_config("max_range_m").get().value
    bias, yaw_rad, points = bias_at_rest(robot, clock), 0.0, []
    for command in TURNS:
        scan_m = lidar.get_value().get().value
        met = scan_m < longest_m
        bearings_rad = yaw_rad + angles_rad[met]
        points.append(scan_m[met, np.newaxis] * np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)]))
        yaw_rad += turned(robot, clock, command, bias)
    return np.concatenate(points), yaw_rad


def draw(points: np.ndarray, out: Path) -> None:
    """Draw the points and the robot."""
    figure = new_figure(8, 6)
    if figure is None:
        return  # a warning says why
    axes = figure.subplots()
    axes.scatter(points[:, 0], points[:, 1], s=6)
    axes.plot(0, 0, "x", color="black")
    axes.set_aspect("equal")
    axes.set_xlabel("x, ahead [m]")
    axes.set_ylabel("y, to the left [m]")
    figure.savefig(out, metadata={"Software": None})
    print(f"{len(points)} points in {out}")


def main() -> None:
    """Read the command line, survey and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--fleet", default="survey")
    parser.add_argument("--robot", default="surveyor")
    parser.add_argument("--out", type=Path, default=Path("map.png"))
    arguments = parser.parse_args()
    with Fleet.load(arguments.fleet) as fleet:
        robot = fleet[arguments.robot]
        points, yaw_rad = survey(robot, fleet.clock)
        nearest_m = float(robot["DepthCamera"].get_value().get().value.min())
    print(f"turned by {math.degrees(yaw_rad):.1f} degrees; the nearest thing in view is {nearest_m:.2f} m ahead")
    draw(points, arguments.out)


if __name__ == "__main__":
    main()
