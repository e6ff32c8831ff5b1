# square.py
from eal_actors import connect

with connect("scout", fleet="home.yaml") as eal:
    base = eal.find_resource("Base")
    pose = eal.find_resource("Pose")
    for _ in range(4):
        eal.send_cmd(base, "f0.4")
        eal.send_cmd(base, "r90")
    x_m, y_m, yaw_rad = eal.get_value(pose).value
    print(f"back at {x_m:.2f} m, {y_m:.2f} m")
