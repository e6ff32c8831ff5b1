from eal_actors.testing import Simulation

robots = {"surveyor": {"plugins": {"sim": {"model": "evbot3", "lidar": {"rays": 8, "noise_m": 0}, "imu": {}}}}}
with Simulation(robots, world="lab") as simulation:
    surveyor = simulation["surveyor"]
    print(surveyor["Lidar"].get_value().get().value)
    print(surveyor["Imu"].send_req("turn_rate").get().value)
