import csv
from pathlib import Path

from eal_actors import Fleet

with Fleet.load("sim") as fleet, Path("path.csv").open("w", newline="") as file:
    robot, rows = fleet["roomba-1"], csv.writer(file)
    for _ in range(20):
        nearest_m = min(robot["Range"].get_value().get().value)
        robot["Base"].set_value([0.2, 0.0] if nearest_m > 0.3 else [0.0, 1.0])  # no get(): it would wait for the end
        pose = robot["Pose"].get_value().get()
        rows.writerow([pose.stamp_s, *pose.value])
        fleet.clock.sleep(0.1)
