"""AGVs in a fleet: the plugin against an AGV that is made with vda5050-sdk, at a real mosquitto."""

from __future__ import annotations

import json
import math
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from vda5050.model.enums import EStopType, OperatingMode
from vda5050.model.state import SafetyState

from eal_actors import Fleet
from eal_actors.actors.robot_view import RobotState
from eal_actors.kernel.errors import EALError, ResourceFaultError, UnavailableError
from tests.unit.plugins.mqtt.rig import Broker, Device, error_of, mqtt_fleet, until_ready, why
from tests.unit.plugins.ros2.rig import wait_for
from tests.unit.plugins.vda5050.rig import Judge, SdkAgv

CALL_S = 60.0


def agv_settings(broker: Broker, serial: str, **more: Any) -> dict[str, Any]:
    return {"broker": broker.url, "manufacturer": "ACME", "serial_number": serial, "speed_m_s": 1.0, **more}


def ready(fleet: Fleet, *robots: str) -> None:
    """Wait until their first state has arrived."""
    for robot in robots:
        wait_for(lambda robot=robot: not error_of(lambda: fleet[robot]["State"].get_value().get()), "no state")  # type: ignore[misc]
        until_ready(fleet, robot, "Base", "Pose", "Battery", "State")


def test_it_drives_by_orders(broker: Broker, tmp_path: Path) -> None:
    """The true path is the AGV's own; every message on the wire fits the published schemas."""
    with (
        Judge(broker) as judge,
        SdkAgv(broker, "one") as agv,
        mqtt_fleet(tmp_path, "vda5050", one=agv_settings(broker, "one")) as fleet,
    ):
        ready(fleet, "one")
        base = fleet["one"]["Base"]
        assert base.send_cmd("goto", [0.4, 0.3, 1.0], timeout_s=CALL_S).get() == 1
        assert agv.pose == pytest.approx((0.4, 0.3, 1.0))
        assert base.send_cmd("l90", timeout_s=CALL_S).get() == 1
        assert agv.pose[2] == pytest.approx(1.0 + math.pi / 2)
        assert base.send_cmd("b0.2", timeout_s=CALL_S).get() == 1
        turned = 1.0 + math.pi / 2
        assert agv.pose[:2] == pytest.approx((0.4 - 0.2 * math.cos(turned), 0.3 - 0.2 * math.sin(turned)))
        assert agv.orders[-1].edges[0].orientation == pytest.approx(math.pi)
        assert base.send_cmd("follow", [0.0, 0.0, 0.2, 0.0, 0.2, 0.2], timeout_s=CALL_S).get() == 1
        assert agv.pose[:2] == pytest.approx((0.2, 0.2))
        assert fleet["one"]["Pose"].get_value().get().value[:2] == pytest.approx([0.2, 0.2], abs=1e-6)
        assert fleet["one"]["Battery"].get_value().get().value == 1.0
        assert json.loads(fleet["one"]["State"].send_req("operatingMode").get().value) == "AUTOMATIC"
        assert fleet["one"]["Actions"].send_req("startCharging", timeout_s=CALL_S).get().value == "FINISHED"
        wait_for(lambda: fleet["one"]["Battery"].send_req("charging").get().value is True, "it does not charge")
        with pytest.raises(ResourceFaultError, match="fly failed"):
            fleet["one"]["Actions"].send_req('{"actionType": "fly"}', timeout_s=CALL_S).get()
        with pytest.raises(EALError):
            base.set_value([0.1, 0.0]).get()
    assert judge.counts["order"] == 4
    assert {"state", "connection", "order", "instantActions"} <= set(judge.counts)


def test_a_halt_cancels_and_the_next_order_is_taken(broker: Broker, tmp_path: Path) -> None:
    with (
        SdkAgv(broker, "halted", speed_m_s=0.3) as agv,
        mqtt_fleet(tmp_path, "vda5050", one=agv_settings(broker, "halted")) as fleet,
    ):
        ready(fleet, "one")
        base = fleet["one"]["Base"]
        driving = base.send_cmd("goto", [50.0, 0.0], timeout_s=CALL_S)
        wait_for(lambda: agv.pose[0] > 0.05, "it does not move")
        base.halt().get()
        with pytest.raises(EALError):
            driving.get()
        wait_for(lambda: "cancelOrder" in agv.actions and "stopPause" in agv.actions, "it was not cancelled")
        x_m = agv.pose[0]
        assert base.send_cmd("goto", [x_m - 0.05, 0.0], timeout_s=CALL_S).get() == 1
        assert agv.pose[0] == pytest.approx(x_m - 0.05)
        again = base.send_cmd("goto", [60.0, 0.0], timeout_s=CALL_S)
        wait_for(lambda: agv.pose[0] > x_m, "it does not move again")
        assert base.send_cmd("goto", [agv.pose[0], 0.0], timeout_s=CALL_S).get() == 1  # a newer command replaces it
        with pytest.raises(EALError):
            again.get()


@pytest.mark.slow
def test_what_an_agv_reports_ends_a_motion_with_its_reason(broker: Broker, tmp_path: Path) -> None:
    with (
        SdkAgv(broker, "trouble", speed_m_s=0.3) as agv,
        mqtt_fleet(tmp_path, "vda5050", one=agv_settings(broker, "trouble")) as fleet,
    ):
        ready(fleet, "one")
        base, publisher = fleet["one"]["Base"], agv.client.publisher
        driving = base.send_cmd("goto", [50.0, 0.0], timeout_s=CALL_S)
        wait_for(lambda: agv.pose[0] > 0.02, "it does not move")
        agv.call(lambda: publisher.set_safety_state(SafetyState(e_stop=EStopType.MANUAL, field_violation=False)))
        with pytest.raises(ResourceFaultError, match="emergency stop is active"):
            driving.get()
        why(fleet, "one", "Base", "emergency stop is active (MANUAL)")
        agv.call(lambda: publisher.set_safety_state(SafetyState(e_stop=EStopType.NONE, field_violation=False)))
        until_ready(fleet, "one", "Base")
        agv.call(lambda: publisher.set_operating_mode(OperatingMode.MANUAL))
        why(fleet, "one", "Base", "mode MANUAL")
        agv.call(lambda: publisher.set_operating_mode(OperatingMode.AUTOMATIC))
        until_ready(fleet, "one", "Base")
        agv.call(lambda: publisher.set_maps([_map("elsewhere")]))
        with pytest.raises(UnavailableError, match="the AGV refuses the order: mapError"):
            base.send_cmd("goto", [1.0, 0.0], timeout_s=CALL_S).get()


def _map(name: str) -> Any:
    from vda5050.model.enums import MapStatus
    from vda5050.model.state import Map

    return Map(map_id=name, map_version="1", map_status=MapStatus.ENABLED)


@pytest.mark.slow
def test_a_lost_agv_is_not_ready_and_another_goes_on(broker: Broker, tmp_path: Path) -> None:
    with (
        SdkAgv(broker, "a", speed_m_s=0.3) as agv,
        SdkAgv(broker, "b") as other,
        mqtt_fleet(tmp_path, "vda5050", a=agv_settings(broker, "a"), b=agv_settings(broker, "b")) as fleet,
    ):
        ready(fleet, "a", "b")
        driving = fleet["a"]["Base"].send_cmd("goto", [50.0, 0.0], timeout_s=CALL_S)
        wait_for(lambda: agv.pose[0] > 0.02, "it does not move")
        agv.lose()
        with pytest.raises(UnavailableError, match="connection says CONNECTIONBROKEN"):
            driving.get()
        assert fleet["b"]["Base"].send_cmd("goto", [0.1, 0.0], timeout_s=CALL_S).get() == 1
        assert other.pose[0] == pytest.approx(0.1)


BAD = (
    (b"{", "is no state of VDA 5050"),
    (b"\xff", "is no state of VDA 5050"),
    (b"[" * 100_000, "is no state of VDA 5050"),
    (b"x" * 2_000_000, "longer than 1048576 bytes"),
)


@pytest.mark.slow
def test_bad_messages_are_named_and_the_next_state_heals(broker: Broker, tmp_path: Path) -> None:
    topic = "uagv/v2/ACME/bad/"
    with (
        SdkAgv(broker, "bad") as agv,
        Device(broker) as intruder,
        mqtt_fleet(tmp_path, "vda5050", one=agv_settings(broker, "bad")) as fleet,
    ):
        ready(fleet, "one")
        good = fleet["one"]["State"].get_value().get().value
        agv.call(lambda: setattr(agv.client.publisher, "publish", _nothing))
        later = json.loads(good) | {"version": "3.0.0"}
        nan = good.replace('"x": 0.0', '"x": NaN').encode()
        assert nan != good.encode()
        for payload, words in (
            *BAD,
            (json.dumps(later).encode(), "speaks VDA 5050 3.0.0; this side speaks 2.1.0"),
            (nan, "finite"),
            (json.dumps(json.loads(good) | {"driving": "yes"}).encode(), "driving: "),
        ):
            intruder.say(topic + "state", payload)
            why(fleet, "one", "Base", words)
            intruder.say(topic + "state", good)
            until_ready(fleet, "one", "Base")
        assert fleet["one"].state is RobotState.READY
        for _ in range(2000):
            intruder.say(topic + "state", good, qos=0)
        intruder.say(
            topic + "state", json.dumps(json.loads(good) | {"batteryState": {"batteryCharge": 7, "charging": False}})
        )
        wait_for(lambda: fleet["one"]["Battery"].get_value().get().value == 0.07, "the newest state is not there")


async def _nothing() -> None:
    """Publish no state."""


PROGRAM = """
import sys
from eal_actors import Fleet
with Fleet.load(sys.argv[1]) as fleet:
    while True:
        try:
            fleet["one"]["Base"].send_cmd("goto", [50.0, 0.0], timeout_s=60).get()
        except Exception as error:
            print(error, file=sys.stderr)
"""


@pytest.mark.slow
def test_the_broker_stops_an_agv_whose_commander_is_killed(broker: Broker, tmp_path: Path) -> None:
    """`kill -9` of the program: the last will of its connection is `cancelOrder`."""
    content = {"version": 1, "name": "k", "robots": {"one": {"plugins": {"vda5050": agv_settings(broker, "will")}}}}
    (tmp_path / "fleet.yaml").write_text(json.dumps(content))
    with SdkAgv(broker, "will", speed_m_s=0.3) as agv:
        program = subprocess.Popen([sys.executable, "-c", PROGRAM, str(tmp_path / "fleet.yaml")])
        wait_for(lambda: agv.pose[0] > 0.05, "it does not move")
        program.send_signal(signal.SIGKILL)
        program.wait()
        wait_for(lambda: not agv.client.publisher.node_states, "its order is not cancelled")
        assert agv.actions[-1] == "cancelOrder"
        assert agv.pose[0] < 40.0
