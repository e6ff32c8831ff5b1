from eal_actors import Fleet

with Fleet.load("sim") as fleet, fleet["roomba-1"]["Pose"].stream(rate_hz=10) as poses:
    for pose in poses:
        print(pose.value, f"{fleet.clock.now() - pose.stamp_s:.3f} s old")
        if poses.skipped or pose.stamp_s > 0.5:
            break
