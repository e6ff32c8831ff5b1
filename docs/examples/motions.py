from eal_actors import Fleet, gather

with Fleet.load("sim") as fleet:
    roomba, evbot = fleet["roomba-1"], fleet["evbot3-1"]
    gather([roomba.base.turn(90), evbot.base.turn(-90)]).get()  # degrees, to the left if positive
    here = roomba.pose.get().get()
    roomba.base.go_to(here.x_m + 0.3, here.y_m, yaw_deg=180).get()
    roomba.base.follow([(here.x_m + 0.3, here.y_m + 0.3), (here.x_m, here.y_m)]).get()
    print(roomba.pose.get().get().position_std_m, evbot.battery.get().get(), roomba.camera.frame().get().shape)
