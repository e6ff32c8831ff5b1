from eal_actors import Fleet

with Fleet.load("sim") as fleet:
    wheeled = fleet.select(tags=["wheeled"])
    print(fleet.send(wheeled, "Base", "f0.2").get())
    for name, distances in fleet.read(wheeled, "Range").get().items():
        print(f"{name}: nearest {min(distances.value):.2f} m")
