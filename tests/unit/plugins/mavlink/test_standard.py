"""Rules of MAVLink and ArduPilot: requests after a restart, answers to others, unknown values, and speeds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common as mavlink

from tests.unit.plugins.mavlink.rig import Vehicle
from tests.unit.plugins.mavlink.test_bad_input import one_rover
from tests.unit.plugins.mavlink.test_vehicles import CALL_S, ready, settings_of
from tests.unit.plugins.mqtt.rig import error_of, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import free_port, wait_for


class SharedVehicle(Vehicle):
    """A vehicle that refuses to another ground station whatever this one asks for."""

    def _command(self, message: Any, system: int, component: int) -> None:
        super()._command(message, system, component)
        self.wire.mav.command_ack_send(message.command, mavlink.MAV_RESULT_DENIED, 0, 0, 255, component)


def test_a_vehicle_that_restarts_is_asked_for_its_messages_again(tmp_path: Path) -> None:
    """The telemetry ports of ArduPilot send nothing unasked if their SRx parameters are 0."""
    port = free_port()
    with Vehicle(port) as rover, mqtt_fleet(tmp_path, "mavlink", one=settings_of(port)) as fleet:
        rover.streams = set()
        ready(fleet, "one")
        rover.is_mute = True
        why(fleet, "one", "Odometry", "no HEARTBEAT for")
        rover.streams = set()
        rover.is_mute = False
        until_ready(fleet, "one", "Odometry")
        wait_for(lambda: not error_of(lambda: fleet["one"]["Battery"].get_value().get()), "no battery")


def test_an_answer_to_another_ground_station_is_not_ours(tmp_path: Path) -> None:
    port = free_port()
    with SharedVehicle(port) as rover, mqtt_fleet(tmp_path, "mavlink", one=settings_of(port)) as fleet:
        ready(fleet, "one")
        fleet["one"]["Autopilot"].send_cmd("arm", timeout_s=CALL_S).get()
        assert rover.is_armed


def test_an_unknown_voltage_is_no_value(tmp_path: Path) -> None:
    with one_rover(tmp_path) as (fleet, rover, _):
        battery = fleet["one"]["Battery"]
        assert battery.send_req("voltage").get().value == pytest.approx(12.1)
        rover.voltage_mv = 0xFFFF
        words = "does not measure its battery's voltage"
        wait_for(lambda: words in error_of(lambda: battery.send_req("voltage").get()), "it is a value")


def test_a_rover_goes_to_a_pose_at_the_speed_of_the_base(tmp_path: Path) -> None:
    with one_rover(tmp_path) as (fleet, rover, _):
        base = fleet["one"]["Base"]
        base.set_config("speed_m_s", 0.4).get()
        base.send_cmd("goto", [0.5, 0.0, 1.0], timeout_s=CALL_S).get()
        assert rover.speed_m_s == pytest.approx(0.4)
        assert rover.pose == pytest.approx((0.5, 0.0, 1.0), abs=0.13)
