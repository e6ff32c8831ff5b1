from eal_actors import Fleet, gather

with Fleet.load("sim") as fleet:
    start = fleet.together({robot["Base"]: "r45" for robot in fleet.select(tags=["wheeled"])}, lead_s=0.1)
    gather(start.futures).get()
    record = start.record.get()
    print(record.skew_s, "s apart, known to", record.skew_error_s, "s")
    for begin in record.begins:
        print(begin.robot, begin.began_s, begin.error_s)
