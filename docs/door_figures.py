"""Make the pictures of the doors, from what programs of others received: `python -m docs.door_figures`."""

from __future__ import annotations

import base64
import html
import inspect
import json
import math
import os
import shutil
import tempfile
import threading
from pathlib import Path
from typing import Any, Final

from playwright.sync_api import sync_playwright
from vda5050 import OrderBuilder

from eal_actors import Fleet
from eal_actors.kernel.errors import EALError
from eal_actors.managers.plugins import EALPluginManager
from eal_actors.operate.foxglove import LiveView
from eal_actors.operate.hands import HandDriver, HandSettings, InputSource
from eal_actors.operate.hands.sticks import ABS_Y, BTN_TR, EV_ABS, EV_KEY, curved
from eal_actors.operate.notebook import FleetMap
from eal_actors.recording.arena import draw_arena, draw_grid, new_figure
from tests.chromium import FLAGS, MISSING, find_chromium
from tests.operate.foxglove.viewer import Viewer
from tests.operate.hands.test_sticks import event
from tests.standards.drive import drive
from tests.unit.plugins.mavlink.rig import Vehicle
from tests.unit.plugins.mqtt.rig import Broker, Device, error_of, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import free_port, ros2_peer, wait_for
from tests.unit.plugins.vda5050.rig import SdkAgv, SdkMaster

IMAGES: Final = Path(__file__).parent / "images"
SIDE_M: Final = 0.8
SPEED_M_S: Final = 0.25
RATE_RAD_S: Final = 1.0


def fleet_file(folder: Path, robots: dict[str, Any]) -> Path:
    """Write a fleet in the laboratory."""
    file = folder / "fleet.yaml"
    world = str(Path("fleets/worlds/lab.yaml").resolve())
    file.write_text(json.dumps({"version": 1, "name": "figure", "world": world, "robots": robots}))
    return file


def draw_ros2(folder: Path) -> None:
    """Drive a simulated robot by cmd_vel, and draw the odometry and scans that a ROS 2 client received."""
    robots = {"roomba-1": {"plugins": {"sim": {"model": "roomba", "lidar": {"rays": 180}}}}}
    odometry: list[tuple[float, float, float]] = []
    scans: list[tuple[tuple[float, float, float], Any]] = []

    def keep_pose(message: Any) -> None:
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        odometry.append((place.x, place.y, 2 * math.atan2(turn.z, turn.w)))

    def keep_scan(message: Any) -> None:
        if odometry:
            scans.append((odometry[-1], message))

    with ros2_peer(folder / "messages") as router, router as peer, Fleet.load(fleet_file(folder, robots)) as fleet:
        bridge, settings = EALPluginManager().bridge("ros2", {"router": peer.endpoint, "rate_hz": 20})
        with bridge.open_bridge(fleet, settings):
            peer.subscriber("/roomba_1/odom", "nav_msgs/msg/Odometry", keep_pose)
            peer.subscriber("/roomba_1/scan", "sensor_msgs/msg/LaserScan", keep_scan)
            commands = peer.publisher("/roomba_1/cmd_vel", "geometry_msgs/msg/Twist")
            vector = peer.type("geometry_msgs/msg/Vector3")
            for speed, rate, duration_s in ((SPEED_M_S, 0.0, SIDE_M / SPEED_M_S), (0.0, RATE_RAD_S, math.pi / 2)) * 4:
                end_s = fleet.clock.now() + duration_s
                while fleet.clock.now() < end_s:
                    commands.publish(linear=vector(x=speed, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=rate))
                    fleet.clock.sleep(0.05)
    figure = _figure()
    axes = figure.subplots()
    for (x_m, y_m, yaw_rad), scan in scans[:: max(1, len(scans) // 12)]:
        angles = [yaw_rad + scan.angle_min + scan.angle_increment * number for number in range(len(scan.ranges))]
        hits = [(r, a) for r, a in zip(scan.ranges, angles, strict=True) if r < scan.range_max - 0.05]
        axes.plot(
            [x_m + r * math.cos(a) for r, a in hits],
            [y_m + r * math.sin(a) for r, a in hits],
            ".",
            ms=1.5,
            color="#0072b2",
        )
    axes.plot([pose[0] for pose in odometry], [pose[1] for pose in odometry], color="#d55e00", linewidth=2)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title("/roomba_1/odom and /roomba_1/scan, as a ROS 2 client received them", loc="left", fontsize=10)
    draw_grid(axes)
    figure.savefig(IMAGES / "ros2.png")


def draw_vda5050(folder: Path) -> None:
    """Draw two AGVs that are driven by orders, and what a master received of a robot that it drives."""
    with Broker(folder) as broker, SdkAgv(broker, "a", (0.0, 0.0, 0.0)) as a, SdkAgv(broker, "b", (2.0, 0.0, 0.0)) as b:
        for serial, agv in (("a", a), ("b", b)):
            x_m, y_m = agv.pose[:2]
            goal = [x_m, y_m, x_m + 1, y_m, x_m + 1, y_m + 1, x_m, y_m + 1, x_m, y_m]
            settings = {"broker": broker.url, "manufacturer": "ACME", "serial_number": serial}
            with mqtt_fleet(folder, "vda5050", one=settings) as fleet:
                wait_for(lambda fleet=fleet: not error_of(lambda: fleet["one"]["State"].get_value().get()), "no state")  # type: ignore[misc]
                fleet["one"]["Base"].send_cmd("follow", goal, timeout_s=60.0).get()
        driven = _drive_as_master(folder, broker)
    figure = _figure()
    axes = figure.subplots()
    for name, path, colour in (("a", a.path, "#0072b2"), ("b", b.path, "#d55e00"), ("roomba-1", driven, "#009e73")):
        axes.plot([x for x, _ in path], [y for _, y in path], color=colour, linewidth=2, label=name)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.legend(loc="upper center", ncols=3)
    axes.set_title("AGVs a and b by our orders; roomba-1 by another master's", loc="left", fontsize=10)
    axes.set_ylim(-1.4, 1.6)
    draw_grid(axes)
    figure.savefig(IMAGES / "vda5050.png")


def _drive_as_master(folder: Path, broker: Broker) -> list[tuple[float, float]]:
    """Drive a simulated robot along a square by one order; returns the places that the master received."""
    file = folder / "outward.yaml"
    robots = {"roomba-1": {"plugins": {"sim": {"model": "roomba", "start": {"x_m": 0.5, "y_m": -1.2}}}}}
    file.write_text(json.dumps({"version": 1, "name": "outward", "robots": robots}))
    with SdkMaster(broker) as master, Fleet.load(file) as fleet:
        bridge, settings = EALPluginManager().bridge("vda5050", {"broker": broker.url, "visualization_rate_hz": 20})
        with bridge.open_bridge(fleet, settings):
            wait_for(lambda: any(one.agv_position for one in master.states) and bool(master.factsheets), "no state")
            builder = OrderBuilder(order_id="square", manufacturer="EAL", serial_number="roomba-1")
            for number, (x_m, y_m) in enumerate(((0.5, -1.2), (1.3, -1.2), (1.3, -0.4), (0.5, -0.4), (0.5, -1.2))):
                builder.add_node(f"n{number}", x=x_m, y=y_m, map_id="map", allowed_deviation_xy=0.3)
                if number:
                    builder.add_edge(f"n{number - 1}", f"n{number}")
            master.run(master.client.dispatch(builder.build(), "EAL/roomba-1"))
            wait_for(lambda: master.states[-1].last_node_id == "n4", "the square is not driven")
    return [(one.x, one.y) for one in master.poses]


def draw_mavlink(folder: Path) -> None:
    """Draw the true path of an emulated rover within its geofence."""
    port, fence = free_port(), [(-0.5, -0.5), (2.0, -0.5), (2.0, 1.5), (-0.5, 1.5)]
    settings = {"port": f"udp://127.0.0.1:{port}", "auto_arm": True, "geofence": fence, "speed_m_s": 1.0}
    with Vehicle(port) as rover, mqtt_fleet(folder, "mavlink", one=settings) as fleet:
        wait_for(lambda: not error_of(lambda: fleet["one"]["Altitude"].get_value().get()), "no position")
        base = fleet["one"]["Base"]
        base.send_cmd("goto", [0.5, 0.2, 0.0], timeout_s=60.0).get()
        for command in ("f1", "l90", "f1", "l90", "f1", "l90", "f1"):
            base.send_cmd(command, timeout_s=60.0).get()
    figure = _figure()
    axes = figure.subplots()
    axes.plot(*zip(*fence, fence[0], strict=True), "--", color="#d55e00", label="geofence")
    axes.plot(*zip(*rover.path, strict=True), color="#0072b2", linewidth=2, label="path")
    axes.set(xlabel="x, east [m]", ylabel="y, north [m]", aspect="equal")
    axes.legend(loc="upper left")
    axes.set_title("goto 0.5, 0.2, then a square by f1 and l90", loc="left", fontsize=10)
    draw_grid(axes)
    figure.savefig(IMAGES / "mavlink.png")


def draw_mqtt(folder: Path) -> None:
    """Let a fleet hold a temperature by a heater behind a broker, lose the device, and draw what the fleet read."""
    status = ("room/status", "offline")
    topics = {
        "Warmth": {"topic": "room/climate", "value": "number", "field": "temperature", "unit": "degC"},
        "Heater": {"topic": "room/heater/set", "writable": True, "halt": "OFF"},
    }
    settings = {"presence": {"topic": status[0], "online": "online"}, "topics": topics}
    read: list[tuple[float, float, bool]] = []
    warmth = 18.0

    def live(device: Device, fleet: Fleet, begin_s: float, steps: int) -> None:
        nonlocal warmth
        for _ in range(steps):
            heats = bool(device.heard) and device.heard[-1][1] == b"ON"
            warmth += 0.12 if heats else -0.05
            device.say("room/climate", json.dumps({"temperature": round(warmth, 2)}))
            fleet.clock.sleep(0.1)
            seen = float(fleet["room"]["Warmth"].get_value().get().value)
            read.append((fleet.clock.now() - begin_s, seen, heats))
            if not 20.0 <= seen <= 21.0:
                fleet["room"]["Heater"].set_value("ON" if seen < 20.0 else "OFF").get()

    with Broker(folder) as broker, mqtt_fleet(folder, room={"broker": broker.url, **settings}) as fleet:
        begin_s, spans = fleet.clock.now(), []
        for steps in (80, 80):
            with Device(broker, "room/heater/set", will=status) as device:
                device.say(status[0], "online", retain=True)
                device.say("room/climate", json.dumps({"temperature": warmth}))
                until_ready(fleet, "room", "Warmth", "Heater")
                spans.append(fleet.clock.now() - begin_s)
                live(device, fleet, begin_s, steps)
                spans.append(fleet.clock.now() - begin_s)
                device.break_off()
                why(fleet, "room", "Warmth", "offline")
            fleet.clock.sleep(2.0)
    figure = _figure()
    axes = figure.subplots()
    axes.axvspan(spans[1], spans[2], color="#bbbbbb", alpha=0.5, label="device absent")
    for heats, colour, label in ((True, "#d55e00", "heater on"), (False, "#0072b2", "heater off")):
        chosen = [(time_s, seen) for time_s, seen, is_on in read if is_on == heats]
        axes.plot(*zip(*chosen, strict=True), ".", color=colour, label=label)
    axes.set(xlabel="time [s]", ylabel="Warmth [degC]")
    axes.legend(loc="lower right")
    axes.set_title("room/climate as the fleet read it, which switched room/heater/set", loc="left", fontsize=10)
    draw_grid(axes)
    figure.savefig(IMAGES / "mqtt.png")


def draw_standards(folder: Path) -> None:
    """Draw the record of four robots of different standards, one of which fails."""
    driven = drive(folder, failing="rover-1", side_m=0.6)
    shutil.copy(driven.run.path / "trajectory.png", IMAGES / "standards.png")


def draw_foxglove(folder: Path) -> None:
    """Let three robots drive, and draw the hulls, paths and arena that a viewer received."""
    robots = {
        name: {"plugins": {"sim": {"model": name.partition("-")[0]}}} for name in ("evbot2-1", "evbot3-1", "roomba-1")
    }
    paths: dict[str, list[tuple[float, float]]] = {}
    with Fleet.load(fleet_file(folder, robots)) as fleet, LiveView(fleet, port=0) as view, Viewer(view.url) as viewer:
        viewer.subscribe("/tf", "/robots", "/arena")
        driving = [robot["Base"].send_cmd(command) for robot in fleet.values() for command in ("f0.6",)]
        radii: dict[str, float] = {}
        turned = False
        for shown in viewer.messages():
            if shown.topic == "/robots":
                radii = {one["frame_id"]: one["cylinders"][0]["size"]["x"] / 2 for one in shown.message["entities"]}
            for one in shown.message.get("transforms", ()):
                place = one["translation"]
                paths.setdefault(one["child_frame_id"], []).append((place["x"], place["y"]))
            if all(one.done() for one in driving):
                if turned:
                    break
                turned = True
                driving = [robot["Base"].set_value([0.15, 0.3]) for robot in fleet.values()]
        world = fleet.config.world
    figure = _figure()
    axes = figure.subplots()
    if world is not None:
        draw_arena(axes, world)
    for (frame, path), colour in zip(paths.items(), ("#0072b2", "#d55e00", "#009e73"), strict=True):
        axes.plot([x for x, _ in path], [y for _, y in path], color=colour, linewidth=2)
        axes.add_patch(_disc(path[-1], radii[frame], colour))
        axes.annotate(frame.removesuffix("/base"), path[-1], textcoords="offset points", xytext=(12, 8), fontsize=9)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.set_title("/tf and /robots, as a viewer received them", loc="left", fontsize=10)
    figure.savefig(IMAGES / "foxglove.png")


def draw_hand(folder: Path) -> None:
    """Drive a simulated robot by the bytes of a gamepad's events, and draw its path and the stick's curves."""
    read, write = os.pipe()
    os.set_blocking(read, False)
    path: list[Any] = []
    ended: list[EALError] = []
    robots = {"roomba-1": {"plugins": {"sim": {"model": "roomba"}}}}
    with Fleet.load(fleet_file(folder, robots)) as fleet:

        def run() -> None:
            try:
                driver = HandDriver(fleet, ["roomba-1"], HandSettings(0.25, 0.8), lambda _: None)
                driver.run(InputSource("pipe", read, {}))
            except EALError as error:
                ended.append(error)

        thread = threading.Thread(target=run)
        thread.start()
        os.write(write, event(EV_KEY, BTN_TR, 1))
        for step in range(160):
            os.write(write, event(EV_ABS, ABS_Y, -32768) + event(EV_ABS, 0, int(30000 * math.sin(step / 13))))
            fleet.clock.sleep(0.05)
            path.append(fleet["roomba-1"]["TruePose"].get_value().get().value)
        os.close(write)
        thread.join()
    os.close(read)
    figure = _figure()
    left, right = figure.subplots(1, 2)
    left.plot([pose[0] for pose in path], [pose[1] for pose in path], color="#1f6fb4")
    left.set(title="driven by a gamepad's events", xlabel="x [m]", ylabel="y [m]")
    left.set_aspect("equal", "datalim")
    stick = [number / 100 for number in range(101)]
    for expo, colour, line in ((0.0, "#0072b2", "-"), (0.6, "#d55e00", "--"), (1.0, "#009e73", ":")):
        right.plot(stick, [curved(way, expo) for way in stick], line, color=colour, label=f"--expo {expo:g}")
    right.set(title="the stick's curve", xlabel="stick [share of its way]", ylabel="speed [share of the full speed]")
    right.legend(frameon=False)
    for axes in (left, right):
        draw_grid(axes)
    figure.savefig(IMAGES / "hand.png")


def draw_notebook(folder: Path) -> None:
    """Show what a notebook shows: a fleet, a frame and the live map, in a browser."""
    program = find_chromium()
    if program is None:
        raise SystemExit(MISSING)
    with Fleet.load("panorama") as fleet:
        fleet_map = FleetMap(fleet)
        frame = fleet["evbot2-1"]["Camera"].get_value(timeout_s=120).get()
        png = base64.b64encode(frame._repr_png_() or b"").decode()
        pose = html.escape(repr(fleet["evbot2-1"]["Pose"].get_value().get()))
        values = {name: getattr(fleet_map, name) for name in ("world", "poses", "states")}
        script = Path(inspect.getfile(FleetMap)).with_name("fleet_map.js").read_text()
        table = fleet._repr_html_()
        fleet_map.close()
    style = (
        "<style>body{font:14px sans-serif} th,td{padding:3px 9px;text-align:left}"
        " #row{display:flex;gap:14px;align-items:flex-start}</style>"
    )
    model = "{ get: (name) => values[name], on() {}, send() {} }"
    page_text = (
        f"{style}{table}<pre>{pose}</pre><div id=row><img width=400 src='data:image/png;base64,{png}'>"
        "<div id=map></div></div>"
        f"<script type=module>{script.replace('export default { render };', '')}\nconst values = {json.dumps(values)};"
        f"render({{ model: {model}, el: document.getElementById('map') }});</script>"
    )
    (folder / "page.html").write_text(page_text)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1020, "height": 740})
        page.goto((folder / "page.html").as_uri())
        page.screenshot(path=IMAGES / "notebook.png")
        browser.close()


def _figure() -> Any:
    figure = new_figure(7.5, 5.5)
    if figure is None:
        raise SystemExit("the pictures need matplotlib")
    return figure


def _disc(place: tuple[float, float], radius_m: float, colour: str) -> Any:
    from matplotlib.patches import Circle

    return Circle(place, radius_m, facecolor=colour, alpha=0.5)


if __name__ == "__main__":
    doors = (draw_foxglove, draw_hand, draw_mavlink, draw_mqtt, draw_notebook, draw_ros2, draw_standards, draw_vda5050)
    for draw in doors:
        with tempfile.TemporaryDirectory() as made:
            draw(Path(made))
