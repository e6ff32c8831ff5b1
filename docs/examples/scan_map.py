from eal_actors.device.navigation.scan_map import ScanMap
from eal_actors.testing import Simulation

robots = {"scout": {"plugins": {"sim": {"model": "evbot3", "start": {"x_m": 0, "y_m": 0}, "lidar": {}}}}}
with Simulation(robots, world="lab") as simulation:
    scout, scan_map = simulation["scout"], ScanMap()
    angles = scout["Lidar"].send_req("angles").get().value
    for command in ("l90", "f0.5"):
        scout["Base"].send_cmd(command).get()
        pose, scan = scout["Pose"].get_value().get().value, scout["Lidar"].get_value().get().value
        scan_map.add(tuple(pose), scan, angles, max_range_m=8.0)
    print(scan_map.grid().cells.shape)
