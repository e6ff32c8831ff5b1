from eal_actors import Fleet

with Fleet.load("sim") as fleet:
    journey = fleet.go_to({"evbot2-1": (1.2, 0.4), "roomba-1": (-1.2, 0.4, 90)})  # in metres; with a heading in degrees
    print(journey.get())  # {'evbot2-1': 1, 'roomba-1': 1}
