from eal_actors import connect

with connect("roomba-1", fleet="sim") as eal:
    base = eal.find_resource("Base")
    pose = eal.find_resource("Pose")
    for _ in range(4):
        eal.send_cmd(base, "f0.3")
        eal.send_cmd(base, "r90")
    x_m, y_m, yaw_rad = eal.get_value(pose).value
    print(f"back at {x_m:.2f} m, {y_m:.2f} m")
    eal.base.go_to(x_m + 0.2, y_m, yaw_deg=90)  # closed loop, by the estimated pose
