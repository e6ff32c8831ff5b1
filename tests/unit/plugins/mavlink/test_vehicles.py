"""Rovers and copters in a fleet: the plugin against a vehicle of pymavlink's server side, which MAVSDK accepts too."""

from __future__ import annotations

import json
import math
import random
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import ArgumentError, ResourceFaultError, UnavailableError
from tests.unit.plugins.mavlink.rig import Px4Vehicle, SerialWire, Vehicle, connection
from tests.unit.plugins.mqtt.rig import error_of, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import free_port, wait_for

CALL_S = 60.0


def settings_of(port: int | str, **more: Any) -> dict[str, Any]:
    address = f"udp://127.0.0.1:{port}" if isinstance(port, int) else port
    return {"port": address, "speed_m_s": 1.0, "turn_rate_deg_s": 90.0, **more}


def ready(fleet: Fleet, robot: str) -> None:
    wait_for(lambda: not error_of(lambda: fleet[robot]["Altitude"].get_value().get()), "no position")
    until_ready(fleet, robot, "Autopilot", "Pose", "Odometry")


def test_a_rover_is_armed_and_drives(tmp_path: Path) -> None:
    """The true path is the vehicle's own."""
    port = free_port()
    with Vehicle(port) as rover, mqtt_fleet(tmp_path, "mavlink", one=settings_of(port)) as fleet:
        ready(fleet, "one")
        one = fleet["one"]
        base = one["Base"]
        assert why(fleet, "one", "Base", "armed") == "the vehicle is not armed: send `arm` to Autopilot"
        one["Autopilot"].send_cmd("arm", timeout_s=CALL_S).get()
        why(fleet, "one", "Base", "in HOLD, not in GUIDED")
        one["Autopilot"].set_value("GUIDED", timeout_s=CALL_S).get()
        until_ready(fleet, "one", "Base")
        assert base.send_cmd("f0.5", timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.5, 0.0), abs=0.05)
        assert base.send_cmd("l90", timeout_s=CALL_S).get() == 1
        assert rover.pose[2] == pytest.approx(math.pi / 2, abs=0.1)
        assert base.send_cmd("goto", [0.2, 0.4, 0.0], timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.2, 0.4), abs=0.13)
        assert math.remainder(rover.pose[2], math.tau) == pytest.approx(0.0, abs=0.11)
        assert one["Battery"].get_value().get().value == 0.75
        with pytest.raises(ArgumentError, match="no mode 'FLY'"):
            one["Autopilot"].set_value("FLY", timeout_s=CALL_S).get()
        rover.refuses.add(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)
        with pytest.raises(ResourceFaultError, match="refuses to disarm: MAV_RESULT_DENIED"):
            one["Autopilot"].send_cmd("disarm", timeout_s=CALL_S).get()


def test_a_rover_drives_over_tcp(tmp_path: Path) -> None:
    port = free_port()
    rover = Vehicle(connection(f"tcpin:127.0.0.1:{port}"))
    settings = settings_of(f"tcp://127.0.0.1:{port}", auto_arm=True)
    with rover, mqtt_fleet(tmp_path, "mavlink", one=settings) as fleet:
        drive_ahead(fleet, rover)


def test_a_rover_drives_over_a_serial_line(tmp_path: Path) -> None:
    wire = SerialWire()
    settings = settings_of(wire.path, auto_arm=True)
    with Vehicle(wire) as rover, mqtt_fleet(tmp_path, "mavlink", one=settings) as fleet:
        drive_ahead(fleet, rover)


def drive_ahead(fleet: Fleet, rover: Vehicle) -> None:
    ready(fleet, "one")
    assert fleet["one"]["Base"].send_cmd("f0.1", timeout_s=CALL_S).get() == 1
    assert rover.pose[:2] == pytest.approx((0.1, 0.0), abs=0.05)


def test_px4_is_kept_in_offboard_between_motions(tmp_path: Path) -> None:
    """Without set-points PX4 leaves OFFBOARD, and no motion could begin."""
    port = free_port()
    with Px4Vehicle(port) as rover, mqtt_fleet(tmp_path, "mavlink", one=settings_of(port)) as fleet:
        ready(fleet, "one")
        autopilot, base = fleet["one"]["Autopilot"], fleet["one"]["Base"]
        assert autopilot.get_value().get().value == "LOITER"
        with pytest.raises(ArgumentError, match=r"no mode 'GUIDED'; the autopilot has .*MISSION.*OFFBOARD"):
            autopilot.set_value("GUIDED", timeout_s=CALL_S).get()
        assert rover.streamed == 0  # another program may command it
        autopilot.send_cmd("guided", timeout_s=CALL_S).get()
        assert (rover.mode, rover.is_armed) == (Px4Vehicle.OFFBOARD, True)
        streamed = rover.streamed
        wait_for(lambda: rover.streamed > streamed + 5, "set-points cease between motions")
        until_ready(fleet, "one", "Base")
        assert base.send_cmd("f0.3", timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.3, 0.0), abs=0.05)
        rover.mode = Px4Vehicle.MISSION  # by a person at the remote control
        why(fleet, "one", "Base", "in MISSION, not in OFFBOARD")
        assert autopilot.get_value().get().value == "MISSION"
        autopilot.set_value("POSCTL", timeout_s=CALL_S).get()
        assert rover.mode == 3 << 16
        streamed = rover.streamed
        autopilot.set_value("LOITER", timeout_s=CALL_S).get()
        assert rover.streamed == streamed


@pytest.mark.slow
def test_px4_takes_off_above_its_start_and_loiters_when_the_link_ends(tmp_path: Path) -> None:
    """Its take-off command counts from the sea, so that it is flown by positions."""
    port = free_port()
    with Px4Vehicle(port, "copter", loss_s=1.0) as copter:
        with mqtt_fleet(tmp_path, "mavlink", one=settings_of(port, vehicle="copter")) as fleet:
            ready(fleet, "one")
            autopilot = fleet["one"]["Autopilot"]
            autopilot.send_cmd("takeoff2", timeout_s=CALL_S).get()
            assert copter.altitude_m == pytest.approx(2.0, abs=0.25)
            until_ready(fleet, "one", "Base")
            assert fleet["one"]["Base"].send_cmd("goto", [0.5, 0.5], timeout_s=CALL_S).get() == 1
            assert copter.altitude_m == pytest.approx(2.0, abs=0.25)
            assert copter.mode == Px4Vehicle.OFFBOARD
        wait_for(lambda: copter.mode == Px4Vehicle.LOITER, "it does not loiter")
        assert copter.twist == (0.0, 0.0)


@pytest.mark.slow
def test_a_copter_takes_off_flies_within_its_fence_and_lands(tmp_path: Path) -> None:
    port, fence = free_port(), [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
    settings = settings_of(port, vehicle="copter", auto_arm=True, geofence=fence, max_altitude_m=3.0)
    with Vehicle(port, "copter") as copter, mqtt_fleet(tmp_path, "mavlink", one=settings) as fleet:
        ready(fleet, "one")
        autopilot, base = fleet["one"]["Autopilot"], fleet["one"]["Base"]
        with pytest.raises(ArgumentError, match="above max_altitude_m"):
            autopilot.send_cmd("takeoff9", timeout_s=CALL_S).get()
        autopilot.send_cmd("takeoff2", timeout_s=CALL_S).get()
        assert fleet["one"]["Altitude"].get_value().get().value == pytest.approx(2.0, abs=0.25)
        assert base.send_cmd("goto", [0.8, 0.8], timeout_s=CALL_S).get() == 1
        before = copter.set_points
        for command, data in (("goto", [2.0, 0.0]), ("follow", [0.0, 0.0, 2.0, 0.0, 0.0, 0.0]), ("f9", None)):
            with pytest.raises(ArgumentError, match="leaves the geofence"):
                base.send_cmd(command, data).get()
        assert copter.set_points - before <= 3  # zeros of the halt alone
        errors = (error_of(lambda: base.set_value([1.0, 0.0], timeout_s=CALL_S).get()) for _ in range(200))
        assert "geofence" in next(filter(None, errors))
        wait_for(lambda: copter.twist == (0.0, 0.0), "it is not stopped at the fence")
        assert max(map(abs, copter.pose[:2])) <= 1.0
        autopilot.send_cmd("land", timeout_s=CALL_S).get()
        assert not copter.is_armed
        assert copter.altitude_m == pytest.approx(0.0, abs=0.01)


PROGRAM = """
import sys
from eal_actors import Fleet
with Fleet.load(sys.argv[1]) as fleet:
    while True:
        try:
            fleet["one"]["Base"].send_cmd("f50", timeout_s=60).get()
        except Exception as error:
            print(error, file=sys.stderr)
"""


@pytest.mark.slow
def test_a_killed_program_stops_its_vehicle(tmp_path: Path) -> None:
    port = free_port()
    robots = {"one": {"plugins": {"mavlink": settings_of(port, auto_arm=True)}}}
    (tmp_path / "fleet.yaml").write_text(json.dumps({"version": 1, "name": "k", "robots": robots}))
    with Vehicle(port) as rover:
        program = subprocess.Popen([sys.executable, "-c", PROGRAM, str(tmp_path / "fleet.yaml")])
        wait_for(lambda: rover.pose[0] > 0.1, "it does not move")
        program.send_signal(signal.SIGKILL)
        program.wait()
        wait_for(lambda: rover.twist == (0.0, 0.0) and rover.mode == 4, "it does not hold")


@pytest.mark.slow
def test_silence_and_bad_bytes_end_a_motion_or_nothing(tmp_path: Path) -> None:
    seed = random.randrange(2**32)  # noqa: S311
    print("seed", seed)  # noqa: T201
    chance, ports = random.Random(seed), (free_port(), free_port())  # noqa: S311
    robots = {name: settings_of(port, auto_arm=True) for name, port in zip("ab", ports, strict=True)}
    with Vehicle(ports[0]) as rover, Vehicle(ports[1]) as other, mqtt_fleet(tmp_path, "mavlink", **robots) as fleet:
        ready(fleet, "a")
        ready(fleet, "b")
        for _ in range(300):
            rover.say(chance.randbytes(chance.randrange(1, 300)))
        rover.say(b"\xfd" * 60_000)
        wrong = rover.wire.mav.local_position_ned_encode(0, math.nan, 0, 0, 0, 0, 0)
        rover.wire.mav.send(wrong)
        stranger = mavlink.MAVLink(None, 77, 1)
        rover.say(stranger.local_position_ned_encode(0, 50, 50, 0, 0, 0, 0).pack(stranger))
        assert fleet["a"]["Base"].send_cmd("f0.3", timeout_s=CALL_S).get() == 1
        assert rover.pose[:2] == pytest.approx((0.3, 0.0), abs=0.05)
        driving = fleet["a"]["Base"].send_cmd("f50", timeout_s=CALL_S)
        wait_for(lambda: rover.pose[0] > 0.5, "it does not move")
        rover.is_mute = True
        with pytest.raises(UnavailableError, match=r"has sent no .* for"):
            driving.get()
        wait_for(lambda: rover.twist == (0.0, 0.0), "it is not stopped")
        assert fleet["b"]["Base"].send_cmd("f0.3", timeout_s=CALL_S).get() == 1
        assert other.pose[0] == pytest.approx(0.3, abs=0.05)
        rover.is_mute = False
        until_ready(fleet, "a", "Base")
        assert fleet["a"].state is RobotState.READY


@pytest.mark.slow
def test_mavsdk_accepts_the_vehicle() -> None:
    """A ground station that others wrote finds it, reads it, and arms it."""
    mavsdk = pytest.importorskip("mavsdk")
    from mavsdk.plugins.action import Action
    from mavsdk.plugins.telemetry import Telemetry

    port = free_port()
    station = mavsdk.Mavsdk(mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION))
    try:
        station.add_any_connection(f"udpin://127.0.0.1:{port}")
        with Vehicle(port, "copter", (2.0, 1.0, 0.0)) as copter:
            system = station.first_autopilot(CALL_S)
            telemetry, action = Telemetry(system), Action(system)
            wait_for(lambda: abs(telemetry.position_velocity_ned().position.east_m - 2.0) < 1e-3, "no position")
            action.arm()
            assert copter.is_armed
            wait_for(telemetry.armed, "it does not see that it is armed")
    finally:
        station.destroy()
